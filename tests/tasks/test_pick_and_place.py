"""`task:pick_and_place` does what it is for, most of the time."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import tasks
from orbisim.tasks.pick_and_place import PickAndPlace
from orbisim.tasks.tabletop import Cube, Setting


def rate(subtask: str, count: int = 10) -> float:
    task = tasks.make("pick_and_place")
    return float(np.mean([bool(task.episode(subtask, 100 + i).success) for i in range(count)]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("subtask", "least"), [("stack", 0.6), ("unstack", 0.7), ("scattered", 0.7)]
)
def test_success(subtask: str, least: float) -> None:
    assert rate(subtask) >= least


@pytest.mark.parametrize("subtask", ["stack", "unstack", "scattered"])
def test_one_of_two_succeeds(subtask: str) -> None:
    assert rate(subtask, 2) >= 0.5


SETTING = Setting(tuple(Cube(half, 500.0, 0.5, (0, 0, 0)) for half in (0.02, 0.025, 0.03)), 0.5)
TABLE = [[0.4, 0.0, 0.02], [0.5, 0.0, 0.025], [0.6, 0.0, 0.03]]
TOWER = [[0.4, 0.0, 0.11 + 0.02], [0.4, 0.005, 0.06 + 0.025], [0.4, 0.0, 0.03]]
LEANING = [[0.45, 0.0, 0.11 + 0.02], *TOWER[1:]]
DROPPED = [[0.4, 0.0, -0.5], *TABLE[1:]]


@pytest.mark.parametrize(
    ("subtask", "start", "end", "expected"),
    [
        ("stack", TABLE, TOWER, True),
        ("stack", TABLE, TABLE, False),
        ("stack", TABLE, LEANING, False),
        ("unstack", TOWER, TABLE, True),
        ("unstack", TOWER, TOWER, False),
        ("unstack", TOWER, DROPPED, False),
        ("scattered", TABLE, TABLE, False),
        ("scattered", TOWER, TABLE, True),
        ("scattered", TOWER, DROPPED, False),
    ],
)
def test_what_counts_as_success(
    subtask: str, start: list[list[float]], end: list[list[float]], expected: bool
) -> None:
    cubes = np.array([start, end])
    assert PickAndPlace().success(subtask, SETTING, cubes) is expected
