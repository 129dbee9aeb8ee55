"""Trajectories are stored whole."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orbisim import Trajectory, load_scene, make_backend
from orbisim.errors import InputError
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


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The arrays of a saved trajectory of two worlds and three steps."""
    path = tmp_path_factory.mktemp("saved") / "t.npz"
    backend = make_backend("mujoco", load_scene(scenes.CARTPOLE), nworld=2)
    backend.rollout(backend.reset(), np.zeros((3, 1))).save(path)
    return dict(np.load(path))


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "no header": ({"header": None}, "header"),
    "another schema": ({"header": np.array('{"schema": "x"}')}, "orbisim.trajectory/1"),
    "a list": ({"header": np.array("[1]")}, "expected a JSON object"),
    "deep": ({"header": np.array("[" * 100_000 + "]" * 100_000)}, "nested too deeply"),
    "nothing": ({"qpos": None}, "has no 'qpos'"),
    "rank": ({"qpos": np.zeros(3)}, "'qpos' holds float64 of shape"),
    "rows": ({"qvel": np.zeros((2, 4, 2))}, "'qvel' has shape"),
    "width": ({"initial_qpos": np.zeros((2, 5))}, "has shape"),
    "worlds": ({"diverged_at": np.zeros(3, int)}, "'diverged_at' has shape"),
    "text": ({"act": np.array("a")}, "'act' holds <U1"),
    "complex": ({"time": np.zeros((2, 3), complex)}, "'time' holds complex128"),
    "no numbers of steps": ({"diverged_at": np.zeros(2)}, "whole numbers"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_files_that_hold_no_trajectory(tmp_path: Path, saved: dict[str, Any], kind: str) -> None:
    changes, message = WRONG[kind]
    arrays = {name: array for name, array in (saved | changes).items() if array is not None}
    np.savez(tmp_path / "t.npz", **arrays)
    with pytest.raises(InputError, match=re.escape(message)):
        Trajectory.load(tmp_path / "t.npz")


def test_a_trajectory_without_steps(tmp_path: Path) -> None:
    backend = make_backend("mujoco", load_scene(scenes.CARTPOLE))
    backend.rollout(backend.reset(), np.zeros((0, 1))).save(tmp_path / "t.npz")
    loaded, _ = Trajectory.load(tmp_path / "t.npz")
    assert loaded.nstep == 0
    np.testing.assert_array_equal(loaded.final.qpos, loaded.initial.qpos)
