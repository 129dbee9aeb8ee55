"""Mechanisms as USD move as they do from URDF."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orbisim import Scene, load_scene, make_backend
from orbisim.effects import carried_effects
from orbisim.tasks.mechanisms.catalogue import make
from orbisim.tasks.mechanisms.urdf import write_urdf
from orbisim.tasks.mechanisms.usd import write_usd


def moved(scene: Scene, forces: np.ndarray) -> np.ndarray:
    """Positions [T, nq] under generalized forces [T, nv], 20 timesteps each."""
    engine = make_backend("mujoco", scene)
    state, rows = engine.reset(), []
    for force in forces:
        state = engine.step(state.with_memory(qfrc_applied=force[None]), None, 20)
        rows.append(state.qpos[0])
    return np.array(rows)


@pytest.mark.parametrize("family", ["door", "microwave", "pressure_cooker"])
def test_trajectories_are_those_of_the_urdf(family: str, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    mechanism = make(family, 5)
    urdf = load_scene(write_urdf(mechanism, tmp_path), trusted=True)
    usd = load_scene(write_usd(mechanism, tmp_path))
    assert not usd.unsupported and not usd.warnings
    assert carried_effects(usd.model) == carried_effects(urdf.model) == mechanism.effects
    names = [joint.name for joint in mechanism.joints]
    for name in names:
        np.testing.assert_allclose(
            usd.model.joint(name).range, urdf.model.joint(name).range, rtol=1e-6, atol=1e-9
        )
    np.testing.assert_allclose(sorted(usd.model.body_mass), sorted(urdf.model.body_mass), rtol=1e-6)
    order = [int(usd.model.joint(name).dofadr[0]) for name in names]
    own = [int(urdf.model.joint(name).dofadr[0]) for name in names]
    push = 2.0 * np.sin(0.35 * np.arange(50))[:, None] + 1.0 + np.zeros(len(names))
    ways = [moved(urdf, push)[:, own], moved(usd, push)[:, order]]
    assert np.ptp(ways[0], axis=0).max() > 0.005  # it moves
    np.testing.assert_allclose(ways[0], ways[1], atol=1e-4)
