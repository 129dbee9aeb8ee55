"""Simpler explanations: which of nested ones are fitted, and effects instead of retuned numbers."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis import simplification
from orbisim.diagnosis.context import Context, begun
from orbisim.diagnosis.explanations import Found
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.simplification import plain, untuned
from orbisim.effects import EffectInstance
from orbisim.host.deadline import TimeIsUpError
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judged
from orbisim.shooting.retune import Tunable, retuned
from orbisim.shooting.stepping import stepping
from orbisim.testing import inject_effect

FRICTION = EffectInstance("coulomb_friction", "shoulder", {"torque": 0.3})
ROTOR = EffectInstance("armature", "elbow", {"inertia": 0.02})
IDLE = tuple(
    EffectInstance(name, joint, values)
    for joint in ("shoulder", "elbow")
    for name, values in (
        ("sensor_bias", {"offset": 1e-6}),
        ("quadratic_damping", {"coefficient": 1e-5}),
        ("torque_bias", {"offset": 1e-5}),
    )
)


def context_of(arm: orbisim.Scene, *effects: EffectInstance) -> Context:
    runs = inject_effect(arm, list(effects), duration=2.0, episodes=2, noise=1e-4, seed=4)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    return begun(bench, Settings(), lambda _: None).with_tunables()


def places(hypothesis: Hypothesis) -> set[tuple[str, str]]:
    return {(one.effect, one.target) for one in hypothesis.effects}


def counted(context: Context, sizes: list[int]) -> Any:
    def refit(less: Hypothesis, now: Judged) -> Judged | None:
        sizes.append(len(less.effects))
        return context.judge.judge(less, begin=context.judge.begin(now))

    return refit


def test_of_nested_explanations_the_smallest_are_fitted_first(arm: orbisim.Scene) -> None:
    """What has more effects takes longer, and is not fitted where less does as well."""
    context = context_of(arm, FRICTION)
    judged = context.judge.judge(Hypothesis((FRICTION, *IDLE)))
    assert judged is not None
    sizes: list[int] = []
    kept = plain(context, judged, counted(context, sizes))
    assert places(kept.hypothesis) == places(Hypothesis((FRICTION,)))
    assert sizes[0] == 1 and sizes == sorted(sizes) and 4 not in sizes


@pytest.mark.parametrize(("every", "fitted"), [(0.5, [1, 2, 4]), (6.0, [1, 2])])
def test_more_are_fitted_as_long_as_all_of_them_leave_less(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch, every: float, fitted: list[int]
) -> None:
    """Two effects may be worth no more than one where four are."""
    losses = {1: 5.0, 2: 5.0, 4: 1.0}
    context = context_of(arm, FRICTION)
    judged = context.judge.judge(Hypothesis((FRICTION, *IDLE)))
    assert judged is not None
    sizes: list[int] = []

    def refit(less: Hypothesis, _: Judged) -> Any:
        sizes.append(len(less.effects))
        return SimpleNamespace(hypothesis=less, loss=losses[len(less.effects)])

    def less(_: object, one: Any, other: Any) -> Any:
        return SimpleNamespace(total=one.loss - other.loss)

    whole: Any = SimpleNamespace(hypothesis=judged.hypothesis, fit=judged.fit, loss=every)
    monkeypatch.setattr(simplification, "worth", less)
    plain(context, whole, refit)
    assert sizes == fitted


def test_what_no_machine_has_goes_first(arm: orbisim.Scene) -> None:
    """However plainly it shows: friction that falls where no joint ever moves as fast is none."""
    values = {"coulomb": 0.1, "static": 0.3, "velocity": 0.5}
    stiction = EffectInstance("stribeck_friction", "elbow", values)
    context = context_of(arm, FRICTION, stiction)
    judged = context.judge.judge(Hypothesis((FRICTION, stiction)))
    assert judged is not None
    kept = plain(context, judged, counted(context, []))
    assert places(kept.hypothesis) == places(judged.hypothesis)
    first, second = judged.hypothesis.effects
    none = dataclasses.replace(judged.hypothesis, effects=(first, second.replace(velocity=90.0)))
    kept = plain(context, dataclasses.replace(judged, hypothesis=none), counted(context, []))
    assert places(kept.hypothesis) == {("coulomb_friction", "shoulder")}


def test_an_effect_in_the_place_of_retuned_parameters(arm: orbisim.Scene) -> None:
    context = context_of(arm, FRICTION, ROTOR)
    tuned = context.judge.judge(Hypothesis((FRICTION,)).tuned(context.tunables))
    declared = context.judge.judge(Hypothesis())
    assert tuned is not None and declared is not None and tuned.hypothesis.factors
    given = stepping(context.bench.scene)
    found = untuned(Found(context, given, given, declared, tuned), 1).best.hypothesis
    assert found.factors == () and places(found) == places(Hypothesis((FRICTION, ROTOR)))
    (inertia,) = (one.values["inertia"] for one in found.effects if one.effect == "armature")
    assert np.isclose(inertia, ROTOR.values["inertia"], rtol=0.02)


def test_parameters_that_are_off_stay_retuned(arm: orbisim.Scene) -> None:
    """A mass that is declared too small is no load of another shape, nor any other effect."""
    heavier = retuned(arm, {Tunable("mass", "forearm"): 1.04, Tunable("mass", "upper_arm"): 0.97})
    runs = inject_effect(heavier, [FRICTION], duration=2.0, episodes=2, noise=1e-4, seed=4)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    context = begun(bench, Settings(), lambda _: None).with_tunables()
    off = [one for one in context.tunables if one.kind == "mass"]
    tuned = context.judge.judge(Hypothesis((FRICTION,)).tuned(off))
    declared = context.judge.judge(Hypothesis())
    assert tuned is not None and declared is not None and tuned.hypothesis.factors
    given = stepping(context.bench.scene)
    found = Found(context, given, given, declared, tuned)
    assert untuned(found, 1).best is tuned


def test_where_no_effect_has_room_none_takes_the_place_of_retuned_parameters(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    context = context_of(arm, FRICTION, ROTOR)
    full = dataclasses.replace(context, settings=Settings(most_effects=1))
    tuned = context.judge.judge(Hypothesis((FRICTION,)).tuned(context.tunables))
    assert tuned is not None and tuned.hypothesis.factors
    given = stepping(context.bench.scene)
    alone = untuned(Found(full, given, given, tuned, tuned), 1)
    assert not alone.late and places(alone.best.hypothesis) == places(tuned.hypothesis)

    def late(*_: Any) -> None:
        raise TimeIsUpError

    monkeypatch.setattr(simplification, "shortlist", late)
    found = untuned(Found(context, given, given, tuned, tuned), 1)
    assert found.late and places(found.best.hypothesis) == places(tuned.hypothesis)
