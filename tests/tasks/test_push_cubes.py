"""`task:push_cubes` does what it is for, most of the time."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import tasks


def rate(subtask: str, count: int = 5) -> float:
    task = tasks.make("push_cubes")
    return float(np.mean([bool(task.episode(subtask, 100 + i).success) for i in range(count)]))


@pytest.mark.parametrize(("subtask", "least"), [("to_hit", 0.8), ("towards_object", 0.7)])
def test_success(subtask: str, least: float) -> None:
    assert rate(subtask) >= least


def test_numbers_of_cubes_vary() -> None:
    task = tasks.make("push_cubes")
    counts = {task.scene("random", seed).model.nq for seed in range(8)}
    assert counts == {8 + 7 * 3, 8 + 7 * 4}


def test_a_stack_stands_until_it_is_pushed() -> None:
    task = tasks.make("push_cubes")
    for seed in range(4):
        heights = task.episode("stacked", seed).arrays["objects/pos"][:, :, 2]
        assert heights[0].max() > 0.055  # a second cube on a first
        np.testing.assert_allclose(heights[5], heights[0], atol=2e-3)


def test_pushes_towards_an_object_are_slow_and_end_where_the_cubes_meet() -> None:
    task = tasks.make("push_cubes")
    cubes = np.zeros((2, 2, 3))
    cubes[:, 1, 0] = 0.2, 0.15
    assert task.success("towards_object", None, cubes) is True  # type: ignore[attr-defined]
    assert task.success("towards_object", None, cubes[::-1]) is False  # type: ignore[attr-defined]
    assert task.success("random", None, cubes) is None  # type: ignore[attr-defined]
