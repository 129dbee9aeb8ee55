"""`task:toss`: boxes that are thrown."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim.tasks.toss import Toss


def test_cubes_are_cubes_and_boxes_are_not() -> None:
    cube, box = (Toss().scene(name, 1).model.geom("box").size for name in ("cube", "box"))
    assert len(set(cube)) == 1
    assert len(set(box)) == 3


@pytest.mark.parametrize("seed", range(4))
def test_a_toss_starts_above_the_board(seed: int) -> None:
    task = Toss(clearance=0.02)
    episode = task.episode("box", seed)
    model = task.scene("box", seed).model
    pose = episode.arrays["qpos"][0]
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, pose[3:])
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    corners = corners * model.geom("box").size @ matrix.reshape(3, 3).T
    assert pose[2] + corners[:, 2].min() == pytest.approx(0.02)


def test_speeds_are_as_asked() -> None:
    task = Toss(horizontal=1.5, vertical=0.25, spin=7.0)
    qvel = np.array([task.episode("cube", seed).arrays["qvel"][0] for seed in range(6)])
    np.testing.assert_allclose(np.linalg.norm(qvel[:, :2], axis=1), 1.5)
    np.testing.assert_allclose(qvel[:, 2], 0.25)
    np.testing.assert_allclose(np.linalg.norm(qvel[:, 3:], axis=1), 7.0)
    assert np.ptp(np.arctan2(qvel[:, 1], qvel[:, 0])) > 1.0


def test_trials_are_throws_of_one_box() -> None:
    setup = Toss().trials(3, 5)
    model = Toss().scene("cube", 5).model
    assert setup.scene.model.body("box").mass == model.body("box").mass
    first = Toss().episode("cube", 5).arrays
    np.testing.assert_array_equal(setup.initial.qpos[0], first["qpos"][0])
    np.testing.assert_array_equal(setup.initial.qvel[0], first["qvel"][0])
