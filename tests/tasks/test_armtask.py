"""What tasks with an arm share."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim.tasks.arm import PANDA, UR5E
from orbisim.tasks.armtask import controller, cube_positions
from orbisim.tasks.episode import Rollout
from orbisim.tasks.push import Push


def test_one_controller_for_each_arm() -> None:
    assert controller(UR5E) is controller(UR5E)
    assert controller(UR5E) is not controller(PANDA)


def test_the_scene_of_a_seed_begins_where_its_episode_does() -> None:
    task = Push()
    model = task.scene("push", 3).model
    episode = task.episode("push", 3)
    np.testing.assert_array_equal(model.key("start").qpos, episode.arrays["qpos"][0])
    assert episode.steps == task.steps
    assert task.horizon == pytest.approx(task.steps * 0.05)


def test_without_a_seed_it_is_the_asset() -> None:
    model = Push().scene().model
    assert model.body("cube1").mass[0] > 0
    assert Push().scene().fingerprint == Push().scene("push").fingerprint


def test_cubes_in_order() -> None:
    model = Push().scene().model
    qpos = np.arange(2.0 * model.nq).reshape(2, model.nq)
    empty = np.zeros((2, 0))
    cubes = cube_positions(model, Rollout(np.zeros(2), qpos, empty, empty, empty, empty))
    first = int(model.joint("cube1").qposadr[0])
    second = int(model.joint("cube2").qposadr[0])
    np.testing.assert_array_equal(cubes[1, 0], qpos[1, first : first + 3])
    np.testing.assert_array_equal(cubes[1, 1], qpos[1, second : second + 3])
