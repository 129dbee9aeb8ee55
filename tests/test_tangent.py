"""Moving along a tangent vector and measuring it are each other's inverse."""

from __future__ import annotations

import numpy as np

from orbisim import load_scene, make_backend
from orbisim.tangent import perturbed, tangent_difference
from orbisim.testing import scenes


def test_difference_undoes_a_perturbation() -> None:
    backend = make_backend("mujoco", load_scene(scenes.FREE_BODY))
    state = backend.step(backend.reset(4), None, 3)
    dx = np.random.default_rng(0).normal(size=(4, 12))
    moved = perturbed(backend.model, state, dx)
    np.testing.assert_allclose(np.linalg.norm(moved.qpos[:, 3:], axis=1), 1.0)
    found = tangent_difference(backend.model, state, moved)
    np.testing.assert_allclose(found, dx, atol=1e-12)
