"""The search: every move is worth it, or is not made."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.diagnosis import search as searching
from orbisim.diagnosis import worth as worths
from orbisim.diagnosis.conclusion import _as_found, _best_first, _finally, attribute, concluded
from orbisim.diagnosis.context import Context, begun
from orbisim.diagnosis.explanations import TO_THE_END, Found, Tried, best_few
from orbisim.diagnosis.moves import _generalized
from orbisim.diagnosis.proposals import events, exchanges
from orbisim.diagnosis.search import search
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.simplification import plain, told
from orbisim.diagnosis.worth import number_costs, prior, retuning_cost, worth
from orbisim.effects import EffectInstance, find
from orbisim.evidence import EFFECT, like_parts
from orbisim.host.deadline import NEVER, Deadline, TimeIsUpError
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Beginning, Judge, Judged
from orbisim.shooting.retune import SPREAD, Tunable, retuned
from orbisim.shooting.stepping import stepping
from orbisim.shooting.timestep import stepped
from orbisim.testing import inject_effect

ASSETS = Path(__file__).parents[2] / "mjcf_assets"
FRICTION = EffectInstance("coulomb_friction", "shoulder", {"torque": 0.3})
DAMPING = EffectInstance("viscous_damping", "elbow", {"coefficient": 0.08})
BIAS = EffectInstance("torque_bias", "elbow", {"offset": 0.15})
ALLOWED = ("coulomb_friction", "viscous_damping", "torque_bias", "joint_spring", "torque_gain")


def bench_of(
    arm: orbisim.Scene,
    *effects: EffectInstance,
    true: orbisim.Scene | None = None,
    seconds: float = 2.0,
) -> Bench:
    made = {"duration": seconds, "episodes": 2, "noise": 1e-4, "seed": 4}
    runs = inject_effect(true or arm, list(effects), **made)
    return make_bench(arm, prepare_all(runs, arm), 0.5)


def names(hypothesis: Hypothesis) -> set[tuple[str, str]]:
    return {(e.effect, e.target) for e in hypothesis.effects}


@pytest.mark.parametrize(
    "missing",
    [(FRICTION,), pytest.param((FRICTION, DAMPING), marks=pytest.mark.slow)],
    ids=["one", "two"],
)
def test_adds_what_is_missing_and_nothing_else(
    arm: orbisim.Scene, missing: tuple[EffectInstance, ...]
) -> None:
    allowed = ALLOWED if len(missing) > 1 else ALLOWED[:2]
    found = search(bench_of(arm, *missing), Settings(effects=allowed))
    assert names(found.best.hypothesis) == names(Hypothesis(missing))
    assert found.best.ratio < 1.1 and not found.law and not found.late
    assert worth(found.context.bench, found.best, found.best).total == 0


def test_friction_is_found_where_the_scene_disables_constraints(arm: orbisim.Scene) -> None:
    """As dm_control's acrobot does: its machine has friction all the same."""
    spec = arm.spec
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    declared = orbisim.Scene.from_spec(spec, source=arm.source)
    runs = inject_effect(arm, [FRICTION], duration=2.0, episodes=2, noise=1e-4, seed=4)
    bench = make_bench(declared, prepare_all(runs, declared), 0.5)
    found = search(bench, Settings(effects=ALLOWED[:2]))
    assert names(found.best.hypothesis) == names(Hypothesis((FRICTION,)))
    assert found.best.ratio < 1.1
    told = found.best.hypothesis.effects[0].values["torque"]
    assert told == pytest.approx(FRICTION.values["torque"], rel=0.05)


def test_a_right_scene_needs_nothing(arm: orbisim.Scene) -> None:
    found = search(bench_of(arm), Settings(effects=ALLOWED))
    assert found.best is found.declared and not found.tried


def test_a_declared_parameter_that_is_a_little_off_is_no_effect(arm: orbisim.Scene) -> None:
    gain = Tunable("gain", "elbow")
    bench = bench_of(arm, true=retuned(arm, {gain: 1.04}))
    found = search(bench, Settings(effects=ALLOWED))
    assert not found.best.hypothesis.effects
    assert dict(found.best.hypothesis.factors)[gain] == pytest.approx(1.04, abs=0.005)
    after = concluded(found, NEVER)
    assert after.hypothesis.factors and not after.evidence


def test_the_scene_as_declared_is_no_start_for_other_effects(arm: orbisim.Scene) -> None:
    """It is among the fitted where an effect was removed."""
    context = begun(bench_of(arm, FRICTION), Settings(), lambda _: None)
    declared = context.judge.judge(Hypothesis())
    one = context.judge.judge(Hypothesis((FRICTION,)))
    assert declared is not None and one is not None
    assert best_few(context, declared, [declared, one]) == [one]
    assert best_few(context, one, [declared]) == []


def test_through_impacts_what_surely_is_worth_nothing_is_not_restarted(arm: orbisim.Scene) -> None:
    """Restarts take most of the time there; elsewhere a fit may yet get closer."""
    context = begun(bench_of(arm, DAMPING), Settings(), lambda _: None)
    best = context.judge.judge(Hypothesis((DAMPING,)))
    idle = EffectInstance("coulomb_friction", "shoulder", {"torque": 1e-6})
    more = context.judge.judge(Hypothesis((DAMPING, idle)))
    declared = context.judge.judge(Hypothesis())
    assert best is not None and more is not None and declared is not None
    touching = context.on(dataclasses.replace(context.bench, contacts=True))
    gain = worth(touching.bench, best, more)
    assert gain.total + gain.error < 0
    assert best_few(context, best, [more]) == [more]
    assert best_few(touching, best, [more]) == []
    assert best_few(touching, declared, [more]) == [more]


def test_a_needless_effect_is_dropped(arm: orbisim.Scene) -> None:
    """On a machine with another effect besides; what is left is far above the noise."""
    other = EffectInstance("cogging", "elbow", {"amplitude": 0.1, "periods": 3.0, "phase": 0.4})
    context = begun(bench_of(arm, FRICTION, other, seconds=4.0), Settings(), lambda _: None)
    idle = EffectInstance("armature", "shoulder", {"inertia": 1e-4})
    declared = context.judge.judge(Hypothesis())
    both = context.judge.judge(Hypothesis((FRICTION, idle)))
    assert declared is not None and both is not None and both.ratio > 3
    found = concluded(Found(context, *[stepping(context.bench.scene)] * 2, declared, both), NEVER)
    assert names(found.hypothesis) == {("coulomb_friction", "shoulder")}
    ((gone, reason),) = found.rejected
    assert gone.effect == "armature" and "an explanation without it" in reason


def test_what_no_machine_has_is_impossible(arm: orbisim.Scene) -> None:
    """Half a gram, five metres away."""
    place = {"com_x": 5.0, "com_y": 0.0, "com_z": 0.0}
    load = EffectInstance("payload", "forearm", {"mass": 5e-4, **place})
    bench: Any = SimpleNamespace(scene=arm, samples=bench_of(arm).samples)
    assert prior(bench, Hypothesis((load,))) == -np.inf
    assert prior(bench, Hypothesis((FRICTION,))) > prior(bench, Hypothesis((FRICTION, BIAS)))


def test_friction_at_one_joint_makes_it_likelier_at_the_next(arm: orbisim.Scene) -> None:
    """As every joint of a machine has it, more or less; nobody expects a second load."""
    bench: Any = SimpleNamespace(scene=arm, samples=bench_of(arm).samples)

    def more(name: str, places: tuple[str, str], values: dict[str, float]) -> float:
        first, second = (EffectInstance(name, place, values) for place in places)
        return prior(bench, Hypothesis((first, second))) - prior(bench, Hypothesis((first,)))

    joints = len(arm.model.jnt_type)
    assert more("coulomb_friction", ("shoulder", "elbow"), {"torque": 0.1}) == pytest.approx(
        like_parts(2, joints) - EFFECT
    )
    load = {"mass": 0.1, "com_x": 0.0, "com_y": 0.0, "com_z": 0.0}
    one = prior(bench, Hypothesis((EffectInstance("payload", "upper_arm", load),)))
    assert more("payload", ("forearm", "upper_arm"), load) == pytest.approx(one)


def test_what_there_is_is_restarted_as_often_as_what_takes_its_place() -> None:
    """Else an effect wins through impacts by starts that were not found without it."""
    asked: dict[str, Any] = {}

    def judge(hypothesis: Hypothesis, **more: Any) -> None:
        asked.update(more)

    begins: Any = SimpleNamespace(judge=judge, begin=lambda one: one)
    current: Any = SimpleNamespace(hypothesis=Hypothesis())
    better: Any = object()
    context: Any = SimpleNamespace(judge=begins)
    assert searching._fairly(context, current, better) is None
    assert asked == {"begin": better, "restarts": TO_THE_END}


def test_what_looks_the_same_is_proposed_in_its_place(arm: orbisim.Scene) -> None:
    context = begun(bench_of(arm, DAMPING), Settings(), lambda _: None).with_tunables()
    best = context.judge.judge(Hypothesis((DAMPING,)))
    assert best is not None
    fewer = dataclasses.replace(best, hypothesis=Hypothesis())
    proposed = list(exchanges(context, best, 0, fewer))
    tuned = [dict(one.factors) for one in proposed if not one.effects]
    assert [list(factors) for factors in tuned] == [[Tunable("damping", "elbow")]]


def test_what_did_nearly_as_well_is_proposed_in_the_place_of_a_single_effect(
    arm: orbisim.Scene,
) -> None:
    """Steps, or times of commands, may have become others since it was compared. Beside others it
    is not: all are selected anew together there."""
    context = begun(bench_of(arm, DAMPING), Settings(), lambda _: None)
    best = context.judge.judge(Hypothesis((DAMPING,)))
    assert best is not None
    friction = EffectInstance("coulomb_friction", "elbow", {"torque": 0.2})
    runners = [DAMPING, friction]
    fewer = dataclasses.replace(best, hypothesis=Hypothesis())
    proposed = list(exchanges(context, best, 0, fewer, runners))
    assert [one.effects for one in proposed].count((friction,)) == 1
    assert not any(one.effects == (DAMPING,) for one in proposed)
    spring = EffectInstance("joint_spring", "shoulder", {"stiffness": 1.0, "rest_position": 0.0})
    two = dataclasses.replace(best, hypothesis=Hypothesis((DAMPING, spring)))
    beside = dataclasses.replace(best, hypothesis=Hypothesis((spring,)))
    proposed = list(exchanges(context, two, 0, beside, runners))
    assert not any(friction in one.effects for one in proposed)


def test_no_effect_is_proposed_twice_at_a_target(arm: orbisim.Scene) -> None:
    """What generalizes an effect may be there already: with other numbers it is the same one."""
    heavy = EffectInstance(
        "payload", "forearm", {"mass": 0.2, "com_x": 0.0, "com_y": 0.0, "com_z": 0.0}
    )
    offset = find("com_offset").trials(arm.model, "forearm")[0]
    part = EffectInstance("com_offset", "forearm", dict(offset))
    context = begun(bench_of(arm, heavy), Settings(), lambda _: None)
    both = context.judge.judge(Hypothesis((heavy, part)))
    fewer = context.judge.judge(Hypothesis((heavy,)))
    assert both is not None and fewer is not None
    for other in exchanges(context, both, 1, fewer):
        places = [(e.effect, e.target) for e in other.effects]
        assert len(set(places)) == len(places)
    for judged in _generalized(context, fewer, [both]):
        places = [(e.effect, e.target) for e in judged.hypothesis.effects]
        assert len(set(places)) == len(places)


def test_events_are_tried_where_something_is_left(arm: orbisim.Scene) -> None:
    """A stop where simulation likes it best, at the joint at which something is left."""
    travel = np.linspace(-0.5, 1.5, 201)
    absolute = np.stack([travel, 0 * travel, 0 * travel, 0 * travel], axis=1)
    samples = SimpleNamespace(absolute=absolute, usable=np.ones(201, bool))
    bench = SimpleNamespace(scene=arm, contacts=False, samples=[samples])

    fitted_starts = Beginning(start=np.ones((1, 4)))

    def quick_loss(hypothesis: Hypothesis, begin: Beginning) -> float:
        fitted.append(hypothesis)
        return abs(hypothesis.effects[-1].values["position"] - 1.44)

    def glance(hypothesis: Hypothesis, begin: Beginning, every: bool) -> float:
        assert every  # an event may happen in few windows
        assert not np.any(begin.start)  # starts that were fitted without it pass it by
        return abs(hypothesis.effects[-1].values["position"] - 1.43)

    fitted: list[Hypothesis] = []
    judge = SimpleNamespace(
        quick_loss=quick_loss, glance=glance, begin=lambda judged: fitted_starts
    )
    context: Any = SimpleNamespace(
        bench=bench, judge=judge, allowed=lambda one: one.effect == "hard_stop"
    )
    current: Any = SimpleNamespace(hypothesis=Hypothesis())
    found = [one.instance for one in events(context, current, np.array([0.9, 0.01]))]
    assert [one.target for one in found] == ["shoulder"] * 2
    places = [(one.values["position"], one.values["side"]) for one in found]
    np.testing.assert_allclose(places, [(1.44, 1.0), (-0.34, -1.0)])  # 3 % of the travel
    assert len(fitted) == 6  # those that a glance likes best, on either side
    current.hypothesis = Hypothesis((found[0],))
    assert list(events(context, current, np.array([0.9, 0.01]))) == []


def test_motion_that_begins_beyond_a_stop_shows_it_where_it_turns(arm: orbisim.Scene) -> None:
    begins = np.array([0.9, 0.6, 0.2, 0.5, 0.7, 0.3])  # at 0.9, and never again
    swings = np.array([0.0, 0.4, 0.71, 0.2, 0.69, 0.1])
    upper, _ = find("hard_stop").places(arm.model, "elbow", [begins, swings])
    assert {0.9, 0.71, 0.7} <= {round(one["position"], 9) for one in upper}


class Counted:
    """A deadline that passes after so many checks."""

    def __init__(self, checks: int) -> None:
        self.checks, self.left = checks, float("inf")

    @property
    def passed(self) -> bool:
        return self.checks < 0

    def check(self) -> None:
        self.checks -= 1
        if self.passed:
            raise TimeIsUpError


def test_the_best_so_far_is_returned_when_the_time_is_up(arm: orbisim.Scene) -> None:
    whole = bench_of(arm, FRICTION, DAMPING, BIAS)
    soon, few = cast(Any, Counted(300)), Settings(retune=False, effects=ALLOWED)
    found = attribute(dataclasses.replace(whole, deadline=soon), few)
    assert found.cut_short and 10 < found.after.ratio < 0.9 * found.before.ratio
    assert found.bench.deadline is NEVER
    none = search(dataclasses.replace(whole, deadline=Deadline(0.0)), Settings())
    assert none.late and none.best is none.declared


LOAD = EffectInstance(
    "payload", "forearm", {"mass": 0.1, "com_x": 0.1, "com_y": -9.98, "com_z": 0.0}
)
"""Nothing is attached ten metres beside an arm."""


def test_what_two_impossible_explanations_differ_by_is_a_number(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their prior odds are the same, and no reason to drop what is in one of them."""
    bench = bench_of(arm, FRICTION)
    judged = begun(bench, Settings(), lambda _: None).judge.judge(Hypothesis((FRICTION,)))
    assert judged is not None and prior(bench, Hypothesis((LOAD,))) == -np.inf
    monkeypatch.setattr(worths, "log_prior", lambda _, one, __: prior(bench, one.hypothesis))
    less = dataclasses.replace(judged, hypothesis=Hypothesis((LOAD,)), fitted=judged.fitted + 5.0)
    more = dataclasses.replace(judged, hypothesis=Hypothesis((LOAD, FRICTION)))
    assert worth(bench, less, more).total > 0
    assert worth(bench, judged, more).total == -np.inf


def test_what_all_windows_do_not_determine_stays_where_it_was(arm: orbisim.Scene) -> None:
    """A number that some windows do not determine is fitted to all; where that leads to what no
    machine has, it keeps its value."""
    bench = bench_of(arm)
    known = LOAD.replace(com_y=0.0)

    def judge(hypothesis: Hypothesis, *_: Any, **__: Any) -> Any:
        effect = known if hypothesis.frozen else LOAD
        fitted = dataclasses.replace(hypothesis, effects=(effect,))
        return SimpleNamespace(hypothesis=fitted, loss=1.0, ratio=3.0)

    own: Any = SimpleNamespace(judge=judge, begin_joined=lambda *_: None)
    context: Any = SimpleNamespace(bench=bench, judge=own)
    before: Any = SimpleNamespace(hypothesis=Hypothesis((known,), frozen=frozenset({(0, "com_y")})))
    found: Any = SimpleNamespace(context=context)
    last = _finally(found, context, before, before.hypothesis)
    assert last is not None and last.hypothesis.effects == (known,)


def test_a_number_of_a_usual_size_costs_the_width_of_its_prior(arm: orbisim.Scene) -> None:
    clock = EffectInstance("clock_skew", "recording", {"factor": 1.002})
    context = begun(bench_of(arm, clock), Settings(), lambda _: None)
    judged = context.judge.judge(Hypothesis((clock, DAMPING)))
    assert judged is not None
    most = 0.5 * np.log(1000.0)

    def costs(deviation: float) -> list[float]:
        known = np.diag([deviation**2, 1e-12])
        fit = dataclasses.replace(judged.fit, covariance=known)
        return list(number_costs(context.bench, dataclasses.replace(judged, fit=fit), 1000.0))

    assert costs(2e-4) == pytest.approx([np.log(np.sqrt(np.pi / 2) * 5), most])
    assert costs(1e-9) == pytest.approx([most, most])  # never more than one of unknown size
    assert costs(1.0) == pytest.approx([0.0, most])  # nor a reward
    held = dataclasses.replace(judged.hypothesis, frozen=frozenset({(1, "coefficient")}))
    known = dataclasses.replace(judged, hypothesis=held)
    assert len(number_costs(context.bench, known, 1000.0)) == 1  # what is not determined is free


def test_declared_parameters_that_grow_alike_cost_what_is_known_of_their_ratios(
    arm: orbisim.Scene,
) -> None:
    context = begun(bench_of(arm, FRICTION), Settings(), lambda _: None).with_tunables()
    assert len(context.tunables) >= 3
    judged = context.judge.judge(Hypothesis((FRICTION,)).tuned(context.tunables[:3]))
    assert judged is not None and len(judged.hypothesis.factors) == 3
    plain = dataclasses.replace(
        judged.hypothesis, factors=tuple((one, 1.0) for one, _ in judged.hypothesis.factors)
    )
    first, known = len(judged.fit.values) - 3, 1e-3

    def cost(covariance: np.ndarray) -> float:
        whole = np.eye(len(judged.fit.values))
        whole[first:, first:] = covariance
        fit = dataclasses.replace(judged.fit, covariance=whole)
        found = dataclasses.replace(judged, fit=fit, hypothesis=plain)
        return retuning_cost(context.bench, found, 1e6)

    each = np.log(SPREAD / known)
    assert cost(known**2 * np.eye(3)) == pytest.approx(3 * each)
    together = known**2 * np.eye(3) + np.ones((3, 3))  # each alone is hardly known
    assert cost(together) == pytest.approx(2 * each, rel=1e-3)


def test_what_cannot_be_told_from_nothing_goes_but_not_what_is_refined(
    arm: orbisim.Scene,
) -> None:
    """Static friction that is refined by nothing of the machine, and an idle inertia."""
    context = begun(bench_of(arm, FRICTION), Settings(), lambda _: None)
    rise = {"coulomb": 0.0, "static": 0.01, "velocity": 0.05}
    idle = EffectInstance("armature", "shoulder", {"inertia": 1e-4})
    every = Hypothesis((FRICTION, EffectInstance("stribeck_friction", "shoulder", rise), idle))
    judged = context.judge.judge(every)
    assert judged is not None

    def refit(less: Hypothesis, now: Judged) -> Judged | None:
        return context.judge.judge(less, begin=context.judge.begin(now))

    kept = plain(context, judged, refit).hypothesis
    assert ("coulomb_friction", "shoulder") in names(kept)
    assert ("armature", "shoulder") not in names(kept)


def test_a_form_that_is_settled_before_a_move_is_no_reason_for_another_round(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In other steps the second round finds no move: a third would only try the same once more."""
    rounds: list[int] = []

    def moved(found: Found, number: int) -> Found:
        rounds.append(number)
        if number > 1:
            return found
        best = found.context.judge.judge(Hypothesis((FRICTION,)))
        assert best is not None
        return dataclasses.replace(found, best=best)

    def anew(found: Found) -> Found:
        finer = stepped(found.context.bench, stepping(found.context.bench.scene).timestep / 2)
        return dataclasses.replace(found, context=found.context.trying(finer))

    for name, stand_in in (("_moved", moved), ("_anew", anew)):
        monkeypatch.setattr(searching, name, stand_in)
    for name in ("_coarsened", "_in_best_form", "_in_given_steps", "named"):
        monkeypatch.setattr(searching, name, lambda found: found)
    found = search(bench_of(arm, FRICTION), Settings())
    assert rounds == [1, 2] and names(found.best.hypothesis) == {("coulomb_friction", "shoulder")}


def test_what_starts_through_impacts_leave_is_nothing_that_is_missing(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where bodies touch and the declared scene is near the noise, it is restarted before anything
    is looked for; a scene that is far off is not, as that takes long and shows nothing."""
    bench = dataclasses.replace(bench_of(arm), contacts=True)
    context = begun(bench, Settings(), lambda _: None)
    declared = context.judge.judge(Hypothesis())
    assert declared is not None
    restarted: list[int] = []

    def closer(self: Judge, judged: Judged, iterations: int = 5, restarts: int = 1) -> Judged:
        restarted.append(restarts)
        return declared

    screened = Exception("screened")

    def screen(*_: Any) -> None:
        raise screened

    monkeypatch.setattr(Judge, "closer", closer)
    monkeypatch.setattr(Context, "screen", screen)
    for ratio, restarts in ((1.4, [TO_THE_END]), (2.0, [])):
        restarted.clear()
        poor = dataclasses.replace(
            declared, ratio=ratio, fitted=ratio**2 * declared.fitted,
            checked=ratio**2 * declared.checked,
        )  # fmt: skip
        monkeypatch.setattr(Judge, "judge", lambda *_, poor=poor, **__: poor)
        if restarts:
            found = search(bench, Settings())
            assert found.best is declared and not found.tried
        else:
            with pytest.raises(Exception, match="screened"):
                search(bench, Settings())
        assert restarted == restarts * len(restarted)


def test_what_was_fitted_in_time_is_compared_and_kept(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock ends while a move is weighed: the move is the answer all the same."""
    from orbisim.diagnosis import search as module

    bench = bench_of(arm, FRICTION)
    context = begun(bench, Settings(), lambda _: None)
    declared, best = (context.judge.judge(Hypothesis(e)) for e in ((), (FRICTION,)))
    assert declared is not None and best is not None
    late: Any = Counted(-1)
    passed = begun(dataclasses.replace(bench, deadline=late), Settings(), lambda _: None)
    assert passed.chance is not None and passed.chance() is not None
    tried = Tried(best, 1, worth(bench, declared, best))
    monkeypatch.setattr(module, "earlier", lambda *_: None)
    monkeypatch.setattr(module, "best_move", lambda *_: (best, [tried], False))
    monkeypatch.setattr(module, "_fairly", lambda *_: late.check())
    found = module._moved(
        Found(context, *[stepping(context.bench.scene)] * 2, declared, declared), 1
    )
    assert found.late and found.best is best and found.tried == (tried,)


def test_controls_that_lead_are_not_lost_where_the_time_is_up(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    from orbisim.diagnosis import search as module

    context = begun(bench_of(arm, FRICTION), Settings(), lambda _: None)
    declared, other = (context.judge.judge(Hypothesis(e)) for e in ((), (FRICTION,)))
    assert declared is not None and other is not None
    # stands for the declared scene with other controls: what it leaves is little
    better = dataclasses.replace(other, hypothesis=Hypothesis())
    monkeypatch.setattr(module, "done", lambda *_: False)
    monkeypatch.setattr(module, "earlier", lambda *_: (context, better))
    monkeypatch.setattr(module, "best_move", lambda *_: (None, [], True))
    found = module._moved(
        Found(context, *[stepping(context.bench.scene)] * 2, declared, declared), 1
    )
    assert found.late and found.best is better


@pytest.mark.parametrize("until", [Deadline(0.0), NEVER])
def test_what_cannot_be_told_from_nothing_is_not_the_answer_where_the_time_is_up(
    arm: orbisim.Scene, until: Deadline, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether or not there is time for nested explanations, of which the best may have it."""
    from orbisim.diagnosis import conclusion as module

    if until is NEVER:
        monkeypatch.setattr(module, "plain", lambda _, judged, __: judged)
    context = begun(bench_of(arm, FRICTION), Settings(), lambda _: None)
    idle = EffectInstance("armature", "shoulder", {"inertia": 1e-4})
    declared, both = (context.judge.judge(Hypothesis(e)) for e in ((), (FRICTION, idle)))
    assert declared is not None and both is not None
    found = _as_found(
        Found(context, *[stepping(context.bench.scene)] * 2, declared, both, late=True), until
    )
    assert names(found.hypothesis) == {("coulomb_friction", "shoulder")}
    (torque,) = found.hypothesis.values(arm)
    alone = context.judge.judge(Hypothesis((FRICTION,)))
    assert alone is not None
    assert torque == pytest.approx(alone.fit.values[0], rel=0.02)


def test_what_is_refined_stays_as_long_as_what_refines_it(arm: orbisim.Scene) -> None:
    """Nothing is missing: friction and its rise at rest are dropped, the rise first."""
    context = begun(bench_of(arm), Settings(), lambda _: None)
    little = EffectInstance("coulomb_friction", "shoulder", {"torque": 1e-5})
    rise = {"coulomb": 0.0, "static": 1e-5, "velocity": 0.05}
    both = Hypothesis((EffectInstance("stribeck_friction", "shoulder", rise), little))
    judged = context.judge.judge(both)
    assert judged is not None
    wide = dataclasses.replace(judged.fit, covariance=np.eye(len(judged.fit.values)))
    found = told(context, dataclasses.replace(judged, fit=wide))
    assert not found.hypothesis.effects and not len(found.fit.values)


def test_what_wider_intervals_leave_untold_is_not_named(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where bodies touch, intervals are known to be wider only when all else is decided. Numbers of
    what stays are those without what goes."""
    damping = EffectInstance("viscous_damping", "shoulder", {"coefficient": 0.05})
    context = begun(bench_of(arm, FRICTION, damping), Settings(), lambda _: None)
    declared, both = (context.judge.judge(Hypothesis(e)) for e in ((), (FRICTION, damping)))
    assert declared is not None and both is not None
    found = Found(context, *[stepping(context.bench.scene)] * 2, declared, both)
    assert len(concluded(found, NEVER).hypothesis.effects) == 2

    def unsure(_: Judge, judged: Judged) -> Judged:
        if len(judged.hypothesis.effects) < 2:
            return judged
        covariance = judged.fit.covariance.copy()
        covariance[1, 1] += 1e6
        return dataclasses.replace(
            judged, fit=dataclasses.replace(judged.fit, covariance=covariance)
        )

    monkeypatch.setattr(Judge, "as_sure", unsure)
    after = concluded(found, NEVER)
    assert [one.effect for one in after.hypothesis.effects] == ["coulomb_friction"]
    assert [one.effect for one, _ in after.rejected] == ["viscous_damping"]
    assert len(after.evidence) == 1
    alone = context.whole(NEVER, 96).judge.judge(Hypothesis((FRICTION,)), 8)
    assert alone is not None
    assert after.after.fit.values[0] == pytest.approx(alone.fit.values[0], rel=0.02)
    assert after.after.fit.values[0] > 1.05 * both.fit.values[0]


def test_what_there_is_no_time_to_fit_without_stays_with_its_interval(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The final fit is not lost because the time is up once intervals are known."""
    context = begun(bench_of(arm, FRICTION), Settings(), lambda _: None)
    declared, best = (context.judge.judge(Hypothesis(e)) for e in ((), (FRICTION,)))
    assert declared is not None and best is not None
    found = Found(context, *[stepping(context.bench.scene)] * 2, declared, best)

    def late(*_: object, **__: object) -> Judged:
        raise TimeIsUpError

    def unsure(_: Judge, judged: Judged) -> Judged:
        monkeypatch.setattr(Judge, "judge", late)
        fit = dataclasses.replace(judged.fit, covariance=1e12 * judged.fit.covariance)
        return dataclasses.replace(judged, fit=fit)

    monkeypatch.setattr(Judge, "as_sure", unsure)
    after = concluded(found, NEVER)
    assert [one.effect for one in after.hypothesis.effects] == ["coulomb_friction"]
    assert after.after.fit.covariance[0, 0] > 1e6 * best.fit.covariance[0, 0]
    assert not after.rejected and len(after.evidence) == 1


def test_where_the_time_was_up_what_was_sure_at_first_is_the_answer(arm: orbisim.Scene) -> None:
    """Only the form of the data had been changed: the best so far explains nothing by itself."""
    context = begun(bench_of(arm, FRICTION), Settings(), lambda _: None)
    declared, sure = (context.judge.judge(Hypothesis(e)) for e in ((), (FRICTION,)))
    assert declared is not None and sure is not None
    tried = Tried(sure, 1, worth(context.bench, declared, sure))
    found = Found(
        context, *[stepping(context.bench.scene)] * 2, declared, declared, tried=(tried,), late=True
    )
    assert _best_first(found) == [sure]
    assert _best_first(dataclasses.replace(found, best=sure)) == [sure]
    for after in (concluded(found, NEVER), _as_found(found), _as_found(found, Deadline(0.0))):
        assert [one.effect for one in after.hypothesis.effects] == ["coulomb_friction"]


@pytest.mark.parametrize(
    ("effect", "step", "gained", "ended"),
    [
        (FRICTION, 0.002, 0.1, True),  # other values are worth nothing
        (FRICTION, 0.002, 5.0, False),
        (DAMPING, 0.002, 0.1, False),  # another effect
        (FRICTION, 0.001, 0.1, False),  # other steps
    ],
)
def test_a_round_that_changes_no_more_than_values_is_the_last(
    effect: EffectInstance, step: float, gained: float, ended: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def found(effect: EffectInstance, step: float) -> Any:
        best = SimpleNamespace(hypothesis=Hypothesis((effect,)))
        bench = SimpleNamespace(scene=step, lead=None)
        return SimpleNamespace(best=best, context=SimpleNamespace(bench=bench))

    monkeypatch.setattr(searching, "stepping", lambda scene: scene)
    monkeypatch.setattr(searching, "done", lambda context, judged: False)
    monkeypatch.setattr(searching, "worth", lambda *_: SimpleNamespace(total=gained))
    before = found(FRICTION, 0.002)
    assert searching._ended(before, found(effect, step)) is ended
    assert searching._ended(before, before)
