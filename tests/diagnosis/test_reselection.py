"""Another set of effects in the place of several that stand for it."""

from __future__ import annotations

import dataclasses

import pytest

import orbisim
from orbisim.diagnosis import reselection
from orbisim.diagnosis.context import begun
from orbisim.diagnosis.explanations import Found
from orbisim.diagnosis.reselection import reselected
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.simplification import not_vague
from orbisim.effects import EffectInstance
from orbisim.host.deadline import Deadline, TimeIsUpError
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.stepping import stepping
from orbisim.testing import inject_effect

CLOCK = EffectInstance("clock_skew", "recording", {"factor": 1.05})
LATE = EffectInstance("sensor_delay", "shoulder", {"delay": 0.009})
LATER = EffectInstance("sensor_delay", "elbow", {"delay": 0.015})
DAMPING = EffectInstance("viscous_damping", "elbow", {"coefficient": 0.08})
LOAD = EffectInstance("payload", "forearm", {"mass": 0.2, "com_x": 0.1, "com_y": 0.0, "com_z": 0.0})


def found_of(
    arm: orbisim.Scene, true: tuple[EffectInstance, ...], named: tuple[EffectInstance, ...]
) -> Found:
    runs = inject_effect(arm, list(true), duration=3.0, episodes=2, noise=1e-4, seed=4)
    context = begun(
        make_bench(arm, prepare_all(runs, arm), 0.5), Settings(effects=FEW), lambda _: None
    )
    declared, best = (context.judge.judge(Hypothesis(some)) for some in ((), named))
    assert declared is not None and best is not None
    context = context.along(best)
    return Found(context, *[stepping(arm)] * 2, declared, best)


def names(found: Found) -> set[tuple[str, str]]:
    return {(one.effect, one.target) for one in found.best.hypothesis.effects}


def test_a_clock_in_the_place_of_what_stood_for_it(arm: orbisim.Scene) -> None:
    gains = [EffectInstance("torque_gain", one, {"gain": 0.92}) for one in JOINTS]
    scale = EffectInstance("sensor_scale", "elbow", {"factor": 1.01})
    found = found_of(arm, (CLOCK, LATE, LATER), (LATE, LATER, *gains, scale, DAMPING))
    assert found.best.ratio > 1.5
    later = reselected(found)
    assert names(later) == {(one.effect, one.target) for one in (CLOCK, LATE, LATER)}
    assert later.best.loss < found.best.loss


def test_a_load_in_the_place_of_two_parts_of_it(arm: orbisim.Scene) -> None:
    down = {"magnitude": 2.0, "x": 0.0, "y": 0.0, "z": -1.0}
    force = EffectInstance("constant_force", "forearm", down)
    inertia = EffectInstance("armature", "elbow", {"inertia": 0.002})
    assert names(reselected(found_of(arm, (LOAD,), (force, inertia)))) == {("payload", "forearm")}


def test_what_cannot_be_told_from_nothing_goes(arm: orbisim.Scene) -> None:
    scale = EffectInstance("sensor_scale", "elbow", {"factor": 1.01})
    there = found_of(arm, (LATE, DAMPING), (LATE, DAMPING, scale))
    best = there.context.judge.judge(there.best.hypothesis)  # with the noise as it is known now
    assert best is not None
    found = not_vague(dataclasses.replace(there, best=best))
    assert names(found) == {(one.effect, one.target) for one in (LATE, DAMPING)}
    assert not_vague(found) is found


def test_what_is_there_stays(arm: orbisim.Scene) -> None:
    found = found_of(arm, (LATE, DAMPING), (LATE, DAMPING))
    assert reselected(found).best is found.best


def test_what_is_there_stays_where_the_time_is_up(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = found_of(arm, (LATE, DAMPING), (DAMPING,))
    late = dataclasses.replace(found, context=found.context.until(Deadline(0.0)))
    assert reselected(late).late and reselected(late).best is found.best
    monkeypatch.setattr(reselection, "_OF_TIME", 0.0)  # its share is over, not the whole time
    soon = dataclasses.replace(found, context=found.context.until(Deadline.after(100.0)))
    assert not reselected(soon).late and reselected(soon).best is found.best


def test_a_set_is_taken_where_there_is_no_time_for_its_form(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    def late(*_: object) -> None:
        raise TimeIsUpError

    monkeypatch.setattr(reselection, "settled", late)
    later = reselected(found_of(arm, (LATE, DAMPING), (DAMPING,)))
    assert names(later) == {(one.effect, one.target) for one in (LATE, DAMPING)}


FEW = (
    "armature", "clock_skew", "constant_force", "payload", "sensor_delay", "sensor_scale",
    "torque_gain", "viscous_damping",
)  # fmt: skip
JOINTS = ("shoulder", "elbow")
