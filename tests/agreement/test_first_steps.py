"""Engines that fail inside Physics say so."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from orbisim import Physics, load_scene, suite
from orbisim.agreement import EngineWarning, FirstSteps
from orbisim.errors import DivergedError, EngineError
from orbisim.testing import scenes
from tests.agreement.engines import FALLING, STAND, Blind, Frozen, Reckless, Rounded, loaded


def physics_with(cls: Any, source: str = FALLING, **options: Any) -> Physics:
    physics = Physics.from_xml_string(source)
    physics.use_backend(cls(), **options)
    return physics


def test_an_engine_that_stands_still_raises_and_names_the_joint() -> None:
    physics = physics_with(Frozen)
    with pytest.raises(EngineError, match=r"nothing accelerates.*joint 'hinge' gains .* rad/s"):
        for _ in range(5):
            physics.step()


def test_warp_does_not_freeze_in_silence() -> None:
    """It does, where a contact is deep at the start and no joint can open it."""
    pytest.importorskip("mujoco_warp")
    physics = Physics.from_xml_string(STAND, backend="warp")
    with pytest.raises(EngineError, match=r"'base' and 'stand' overlap by 30 mm.*<exclude>"):
        for _ in range(5):
            physics.step()


def test_dropped_contacts_are_warned_of_once_and_name_the_pair() -> None:
    physics = physics_with(Blind)
    with pytest.warns(
        EngineWarning, match=r"'free'.*geoms '(box|floor)' and '(box|floor)'"
    ) as seen:
        for _ in range(20):
            physics.step()
    assert len(seen) == 1


def test_divergence_that_only_mujoco_sees() -> None:
    physics = physics_with(Reckless, scenes.diverging('gainprm="1e30"'))
    physics.set_control([0.5])
    with pytest.raises(DivergedError, match="C MuJoCo diverges in this step"):
        physics.step()


def test_right_engines_are_left_in_peace() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", EngineWarning)
        physics = physics_with(Rounded)
        for _ in range(100):
            physics.step(3)


def test_it_can_be_turned_off() -> None:
    physics = physics_with(Frozen, verify=False)
    physics.step(10)
    assert physics.time() == pytest.approx(0.02)


def test_later_steps_are_looked_at_more_and_more_rarely() -> None:
    watch = FirstSteps(loaded(Rounded, load_scene(FALLING)))
    assert [n for n in range(1, 70) if watch.due()] == [1, 2, 3, 4, 5, 8, 16, 32, 64]
    watch.restart()
    assert [n for n in range(1, 20) if watch.due()] == [1, 2, 3, 4, 5, 8, 16]


def test_an_engine_that_freezes_later_is_found() -> None:
    physics = physics_with(Rounded)
    engine = physics._mirror.backend
    physics.step()
    for _ in range(10):
        physics.step()
    engine.step = Frozen.step.__get__(engine)
    with pytest.raises(EngineError):
        for _ in range(12):
            physics.step()


def test_episodes_of_tasks_are_checked_again() -> None:
    """The task changes the model at each reset; the engine is judged on the model as it is."""
    environment = suite.load("reacher", "easy", {"random": 0}, backend=Rounded())
    with warnings.catch_warnings():
        warnings.simplefilter("error", EngineWarning)
        for _ in range(3):
            environment.reset()
            for _ in range(5):
                environment.step(np.ones(2))
