"""What cannot be run in many worlds is said before anything is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from dm_control import composer
from dm_control.rl import control

from orbisim.errors import InputError, UnknownNameError
from orbisim.physics import adopt
from orbisim.vector import from_environment, load
from tests.vector import own


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (("cheetah", "rum", 2), UnknownNameError, "did you mean|known: run"),
        (("cheetah", "run", 0), InputError, "nworld"),
        (("cheetah", "run", 2.5), InputError, "nworld"),
        (("cheetah", "run", 2, "mojoco"), InputError, "mojoco"),
        (("cheetah", "run", 2, "mujoco", "cuda"), InputError, "CPU only"),
    ],
)
def test_arguments(arguments: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        load(*arguments)


def test_random_numbers_are_given_by_the_seed() -> None:
    with pytest.raises(InputError, match="pass seed="):
        load("cheetah", "run", 2, task_kwargs={"random": 0})
    with pytest.raises(InputError, match="seed"):
        load("cheetah", "run", 2, seed=-1)


class _OwnStep(own.Ball):
    def step(self, nstep: int = 1) -> None:
        super().step(nstep)
        self.data.qvel[:] *= 0.9


def _with_own_step(seed: int) -> control.Environment:
    return control.Environment(_OwnStep.from_xml_string(own.XML), own.Reach(random=seed))


def _on_warp(seed: int) -> control.Environment:
    environment = own.environment()(seed)
    adopted: Any = adopt(environment.physics)
    adopted._backend_name = "warp"  # as `use_backend` leaves it
    return environment


def _two_balls(seed: int) -> control.Environment:
    text = (
        own.XML.replace('name="target"', 'name="other"/><site name="target"') if seed else own.XML
    )
    return control.Environment(own.Ball.from_xml_string(text), own.Fixed(random=seed))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda seed: composer.Environment, "got abc.ABCMeta|got builtins"),
        (_with_own_step, r"_OwnStep.step is its own"),
        (_on_warp, "uses backend 'warp'"),
        (_two_balls, "world 1 has another model than world 0: '"),
    ],
    ids=["composer", "step", "backend", "model"],
)
def test_environments_that_are_refused(make: Callable[[int], Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        from_environment(make, 2, seed=0)


def test_the_maker_is_called_as_often_as_needed() -> None:
    for task, calls in ((own.Reach, 1), (own.Fixed, 3)):
        seeds: list[int] = []

        def make(seed: int, task: Any = task, seeds: list[int] = seeds) -> Any:
            seeds.append(seed)
            return own.environment(task)(seed)

        from_environment(make, 3, seed=5)
        assert seeds == [5, 6, 7][:calls]


def test_worlds_of_another_run_differ() -> None:
    found = [load("pendulum", "swingup", 2).reset()["orientation"] for _ in range(2)]
    assert not np.array_equal(*found)
    assert not np.array_equal(found[0][0], found[0][1])
