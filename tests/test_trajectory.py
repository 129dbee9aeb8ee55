"""Trajectories are stored whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from orbisim import Trajectory, load_scene, make_backend
from orbisim.testing import scenes


def test_saving_and_loading(tmp_path: Path) -> None:
    backend = make_backend("mujoco", load_scene(scenes.CARTPOLE), nworld=2)
    controls = np.random.default_rng(0).uniform(-1, 1, (2, 7, 1))
    trajectory = backend.rollout(backend.reset(), controls)
    trajectory.save(tmp_path / "t.npz", scene="cartpole.xml", seed=3)
    loaded, notes = Trajectory.load(tmp_path / "t.npz")
    assert notes == {"scene": "cartpole.xml", "seed": 3}
    for name in ("control", "time", "qpos", "qvel", "act", "sensordata", "diverged_at"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(trajectory, name))
    np.testing.assert_array_equal(loaded.with_initial("qpos"), trajectory.with_initial("qpos"))
    assert loaded.with_initial("qpos").shape == (2, 8, 2)
    np.testing.assert_array_equal(loaded.final.qvel, trajectory.final.qvel)
