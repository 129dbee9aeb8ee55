"""A task for each world, and one that stands for all."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from orbisim.vector.tasks import Tasks, copies, untouched
from orbisim.vector.worlds import NotBatchedError, Worlds


class Task:
    def __init__(self, seed: int) -> None:
        self._random = np.random.RandomState(seed)
        self.limits = {"low": np.array([1.0, 2.0])}
        self.names = ["a", "b"]


def test_worlds_have_their_own_random_numbers() -> None:
    tasks = copies(Task(3), 3, 2)
    for world, task in enumerate(tasks):
        assert task._random.uniform() == np.random.RandomState(3 + world).uniform()


def test_whether_a_task_has_drawn() -> None:
    task = Task(3)
    assert untouched(task, 3)
    assert not untouched(task, 4)
    task._random.uniform()
    assert not untouched(task, 3)
    assert not untouched(object.__new__(Task), 3), "a task without random numbers"


def test_what_differs_stands_for_all_worlds() -> None:
    tasks = Tasks(copies(Task(0), 0, 3))
    for world, height in enumerate((1.0, 2.0, 2.0)):
        tasks.each[world].height = height
        tasks.note(world)
    together = tasks.together(None)
    assert isinstance(together.height, Worlds) and together.height.rows.tolist() == [1, 2, 2]
    assert together.limits is tasks.each[0].limits
    assert tasks.together(np.array([1, 2])).height == 2.0, "the same in these worlds"
    with pytest.raises(NotBatchedError, match="draws random numbers"):
        together._random.uniform()


def test_what_an_episode_sets_anew_is_what_is_read() -> None:
    tasks = Tasks(copies(Task(0), 0, 3))
    for world in range(3):
        tasks.each[world].target = np.array([float(world), 0.0])
        tasks.each[world].tries = 0
        tasks.note(world)
    assert tasks.together(None).target.rows[:, 0].tolist() == [0, 1, 2]
    before = tasks.together(None).target
    tasks.each[1].target = np.array([5.0, 0.0])
    tasks.each[1].tries = 1
    tasks.note(1)
    assert tasks.together(None).target.rows[:, 0].tolist() == [0, 5, 2]
    assert tasks.together(np.array([2, 1])).target.rows[:, 0].tolist() == [2, 5]
    assert before.rows[:, 0].tolist() == [0, 1, 2], "values that were read before"
    assert tasks.together(None).tries.rows.tolist() == [0, 1, 0]
    tasks.each[1].tries = 0.5  # of another type than in the other worlds
    tasks.note(1)
    assert tasks.together(None).tries.rows.tolist() == [0, 0.5, 0]
    tasks.each[1].tries = 2**70  # beyond what an array of integers holds
    tasks.note(1)
    with pytest.raises(NotBatchedError, match="'tries'"):
        tasks.together(None)
    tasks.each[1].tries = 3
    tasks.note(1)
    assert tasks.together(None).tries.rows.tolist() == [0, 3, 0]
    tasks.each[2].target[0] = 7.0  # in place
    tasks.note(2)
    assert tasks.together(None).target.rows[:, 0].tolist() == [0, 5, 7]


def test_not_a_number_is_what_it_is_in_every_world() -> None:
    tasks = Tasks(copies(Task(0), 0, 2))
    for world in range(2):
        tasks.each[world].best = float("nan")
        tasks.each[world].goal = np.array([np.nan, 1.0])
        tasks.note(world)
    together = tasks.together(None)
    assert np.isnan(together.best.rows).all()
    assert together.goal is tasks.each[0].goal


@pytest.mark.parametrize("value", ["left", object(), [1, 2]])
def test_what_is_no_number_cannot_differ(value: Any) -> None:
    tasks = Tasks(copies(Task(0), 0, 2))
    tasks.each[1].side = value
    tasks.each[0].side = None
    tasks.note(1)
    with pytest.raises(NotBatchedError, match="'side'"):
        tasks.together(None)
