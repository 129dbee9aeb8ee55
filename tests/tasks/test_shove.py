"""`task:shove`: motions that differ with a cube's mass, and a gripper of limited force."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import tasks
from orbisim.tasks.episode import Episode

FIRST, SECOND, VELOCITY = 8, 15, 8
"""Coordinates of the cubes, and of the velocity of the first."""


def _episode(subtask: str, seed: int, density: float | None = None, **changes: object) -> Episode:
    if density is not None:
        changes["density"] = (density, density)
    return tasks.make("shove", **changes).episode(subtask, seed)


def _way(episode: Episode, first: int) -> float:
    qpos = episode.arrays["qpos"][:, first : first + 2]
    return float(np.linalg.norm(qpos[-1] - qpos[0]))


def test_thrown_cubes_begin_in_motion_and_mostly_meet() -> None:
    met = 0
    for seed in range(6):
        episode = _episode("thrown", seed)
        assert np.linalg.norm(episode.arrays["qvel"][0, VELOCITY : VELOCITY + 2]) > 0.2
        assert np.abs(np.diff(episode.arrays["ctrl"], axis=0)).max() < 1e-12
        met += _way(episode, SECOND) > 0.002
    assert met >= 4


@pytest.mark.parametrize("force", [0.6, 1.0])
def test_a_weak_gripper_moves_a_heavy_cube_more_slowly(force: float) -> None:
    after = 6  # control steps, while the fingers still open
    ways = []
    for density in (150.0, 900.0):
        qpos = _episode("flick", 1, density, force=force).arrays["qpos"]
        ways.append(
            float(np.linalg.norm(qpos[after, FIRST : FIRST + 2] - qpos[0, FIRST : FIRST + 2]))
        )
    assert ways[0] > 1.2 * ways[1] > 0.0


def test_the_force_is_limited_in_nominal_and_drawn_scenes() -> None:
    task = tasks.make("shove", force=0.7)
    for scene in (task.scene(), task.scene("flick", 3)):
        gripper = scene.model.actuator("gripper").id
        np.testing.assert_allclose(scene.model.actuator_forcerange[gripper], [-0.7, 0.7])
    pushing = tasks.make("push").scene().model
    assert pushing.actuator_forcerange[pushing.actuator("gripper").id, 1] == 60.0


def test_a_lifted_cube_slips_from_a_weak_gripper_if_it_is_heavy() -> None:
    heights = []
    for density, force in ((150.0, 1.0), (900.0, 1.0), (900.0, 60.0)):
        qpos = _episode("lifted", 1, density, force=force, lift=(4.0, 4.0)).arrays["qpos"]
        heights.append(float(qpos[-1, FIRST + 2] - qpos[0, FIRST + 2]))
    assert heights[0] > 0.09 and heights[2] > 0.09
    assert heights[1] < heights[2] - 0.01


def test_strikes_let_go_of_the_cube() -> None:
    arrays = _episode("strikes", 1, steps=100).arrays
    speed = np.linalg.norm(arrays["qvel"][:, VELOCITY : VELOCITY + 2], axis=1)
    assert speed.max() > 0.1
    assert np.abs(np.diff(arrays["ctrl"][-60:], axis=0)).max() > 1e-3


@pytest.mark.parametrize("subtask", ["thrown", "flick", "lifted", "strikes"])
def test_the_same_seed_gives_the_same_episode(subtask: str) -> None:
    a, b = (_episode(subtask, 2, steps=20) for _ in range(2))
    assert all(np.array_equal(a.arrays[name], b.arrays[name]) for name in a.arrays)
