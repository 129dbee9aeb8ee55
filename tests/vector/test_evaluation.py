"""Two ways of calling a task's functions."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim.vector.evaluation import Batched, disagreement
from orbisim.vector.tasks import Tasks
from tests.vector import own


@pytest.fixture
def environment() -> orbisim.vector.VectorEnvironment:
    made = orbisim.vector.from_environment(own.environment(), 4, seed=0)
    made.reset()
    made.step(np.ones((4, 1)))
    return made


def test_they_agree(environment: orbisim.vector.VectorEnvironment) -> None:
    batched = environment._evaluator
    assert isinstance(batched, Batched)
    assert not disagreement(batched, environment._exact, np.arange(4))
    assert not disagreement(batched, environment._exact, np.array([1, 3]))


@pytest.mark.parametrize(
    ("name", "function", "message"),
    [
        ("get_reward", lambda physics: 0.1, "reward differs by up to"),
        ("get_observation", lambda physics: {"other": 1.0}, "observations"),
        ("get_observation", lambda physics: _shifted(physics), "to_target differs"),
    ],
)
def test_what_differs_is_said(
    environment: orbisim.vector.VectorEnvironment, name: str, function: object, message: str
) -> None:
    batched: Any = environment._evaluator
    batched._tasks = Tasks([_other(task, name, function) for task in environment._tasks.each])
    found = disagreement(batched, environment._exact, np.arange(4))
    assert message in found


def _other(task: Any, name: str, function: Any) -> Any:
    """A task with another function."""
    changed = copy.copy(task)
    setattr(changed, name, function)
    return changed


def _shifted(physics: object) -> dict[str, object]:
    found = own.Reach(random=0).get_observation(physics)
    found["to_target"] = found["to_target"] + 1e-12
    return found
