"""`task:stack`: scripted, adapted, and what counts as success."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import load_scene, tasks
from orbisim.tasks.stack import Stack, demonstration
from orbisim.tasks.tabletop import Cube, Setting
from orbisim.tasks.views import free_bodies

SETTING = Setting(tuple(Cube(0.0225, 500.0, 0.5, (0, 0, 0)) for _ in range(3)), 0.5)
TOWER = np.array([[0.5, 0.0, 0.0225], [0.505, 0.0, 0.0675], [0.5, 0.004, 0.1125]])


def rate(subtask: str, seeds: range, **changes: float) -> float:
    task = tasks.make("stack", **changes)
    return float(np.mean([bool(task.episode(subtask, seed).success) for seed in seeds]))


def test_three_cubes() -> None:
    model = load_scene("task:stack").model
    assert free_bodies(model) == ("cube1", "cube2", "cube3")


def test_scripted() -> None:
    assert rate("scripted", range(100, 104)) >= 0.75


@pytest.mark.slow
def test_adapted_episodes_succeed_and_fail() -> None:
    exact, wild = (rate("adapted", range(100, 112), noise=noise) for noise in (0.0, 0.03))
    assert exact >= 0.3 > wild


def test_pieces_of_a_demonstration() -> None:
    pieces = demonstration(0)
    assert [piece.about for piece in pieces] == ["cube2", "cube1", "cube3", "cube2"]
    for piece in pieces:
        assert piece.pos[-1, 2] > 0.15  # free to go elsewhere
        assert set(piece.grip) == {-1.0, 1.0}


def test_what_counts_as_success() -> None:
    def success(end: np.ndarray, before: np.ndarray | None = None) -> bool | None:
        cubes = np.stack([TOWER if before is None else before, *[end] * 9])
        return Stack().success("scripted", SETTING, cubes)

    assert success(TOWER) is True
    assert success(TOWER, TOWER + [0.002, 0, 0]) is False  # it still moves
    assert success(TOWER[[0, 2, 1]]) is False  # in another order
    assert success(TOWER * [1, 1, 0] + [0, 0, 0.0225]) is False


def test_an_adapted_episode_does_not_depend_on_what_was_asked_before() -> None:
    task = tasks.make("stack")
    demonstration.cache_clear()
    first, again = (task.episode("adapted", 100) for _ in range(2))
    np.testing.assert_array_equal(first.arrays["ctrl"], again.arrays["ctrl"])
