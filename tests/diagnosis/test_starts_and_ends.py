"""Where fits begin, what they may end in, and what becomes of parts of an effect."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.attribution import _rivals
from orbisim.diagnosis.bench import Bench, Hypothesis, make_bench
from orbisim.diagnosis.conclusion import _finally, conclude
from orbisim.diagnosis.confidence import confidence
from orbisim.diagnosis.fits import Fit
from orbisim.diagnosis.glances import Candidate
from orbisim.diagnosis.paying import unpaid
from orbisim.diagnosis.rounds import _structural, _tamed, stops, vague
from orbisim.diagnosis.samples import prepare_all
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.state import Rival, SearchState
from orbisim.diagnosis.swapping import _loads, united
from orbisim.effects import EffectInstance
from orbisim.testing import inject_effect

SPRING = EffectInstance("joint_spring", "elbow", {"stiffness": 0.4, "rest_position": 0.5})
SOFT = EffectInstance("joint_spring", "elbow", {"stiffness": 1e-3, "rest_position": 200.0})
BIAS = EffectInstance("torque_bias", "elbow", {"offset": 0.2})
LOAD = EffectInstance(
    "payload", "upper_arm", {"mass": 0.4, "com_x": -0.05, "com_y": 0.0, "com_z": -0.15}
)
LIMIT = EffectInstance("torque_saturation", "shoulder", {"limit": 1.2})


def bench_of(arm: orbisim.Scene, *effects: EffectInstance, noise: float = 1e-4) -> Bench:
    runs = inject_effect(arm, list(effects), duration=4.0, episodes=3, noise=noise, seed=4)
    return make_bench(arm, prepare_all(runs, arm), 0.5)


def search(bench: Bench) -> SearchState:
    return SearchState(bench, Settings(), lambda _: None)


STUCK = EffectInstance(
    "load_dependent_friction", "elbow", {"coefficient": 3.0}, {"load": "external"}
)


def test_friction_that_makes_a_joint_stick_begins_smaller() -> None:
    left = {3.0: 50.0, 1.5: 12.0, 0.75: 4.0, 0.3: 7.0, 0.0: 10.0}

    def glance(hypothesis: Hypothesis) -> float:
        return left[hypothesis.effects[0].values["coefficient"] if hypothesis.effects else 0.0]

    def sized(size: float) -> EffectInstance:
        return dataclasses.replace(STUCK, values={"coefficient": 3.0 * size})

    judge = SimpleNamespace(glance=glance)
    state: Any = SimpleNamespace(judge=judge, bench=SimpleNamespace(contacts=False))
    begun = _tamed(state, Hypothesis().plus, Candidate(STUCK, sized=sized))
    assert begun.values["coefficient"] == 0.75
    small = sized(0.25)
    assert _tamed(state, Hypothesis().plus, Candidate(small, sized=sized)) is small
    assert _tamed(state, Hypothesis().plus, Candidate(STUCK)) is STUCK  # no other size is known


def test_a_long_first_step_is_shortened_until_it_helps(arm: orbisim.Scene) -> None:
    """Where a joint does not stick yet, friction seems to do little."""
    truth = dataclasses.replace(STUCK, values={"coefficient": 0.8})
    state = search(bench_of(arm, truth))
    state.judge.start_from(state.need(Hypothesis()))
    found = state.judge.judge(
        Hypothesis((dataclasses.replace(STUCK, values={"coefficient": 0.3}),)), 8
    )
    assert found is not None
    assert found.hypothesis.effects[0].values["coefficient"] == pytest.approx(0.8, rel=0.02)


def test_a_stiffness_that_may_be_none_is_not_believed(arm: orbisim.Scene) -> None:
    state = search(bench_of(arm, BIAS))
    pulls = state.need(Hypothesis((SOFT,)))
    assert "may be a constant force" in str(vague(state, pulls))
    assert vague(state, state.need(Hypothesis((BIAS,)))) is None
    state = search(bench_of(arm, SPRING))
    assert vague(state, state.need(Hypothesis((SPRING,)))) is None


def test_a_stop_is_placed_by_the_windows_that_feel_it(arm: orbisim.Scene) -> None:
    """None of those that are fitted does."""
    state = search(bench_of(arm))
    glances: list[float] = []

    def blind(hypothesis: Hypothesis) -> float:
        glances.append(hypothesis.effects[-1].values["position"])
        return 1.0

    def square(hypothesis: Hypothesis, *rest: Any) -> Any:
        return SimpleNamespace(square=abs(hypothesis.effects[-1].values["position"] - 0.82))

    state.judge.glance = blind  # type: ignore[method-assign]
    state.judge.score = square  # type: ignore[method-assign, assignment]
    placed = [
        one.values["position"]
        for one in stops(state, Hypothesis(), np.array([1.0, 0.0]))
        if one.values["side"] > 0
    ]
    nearest = min((at for at in glances if at > 0), key=lambda at: abs(at - 0.82))
    assert placed == [nearest] and nearest < max(glances)


def test_what_some_windows_did_not_determine_all_windows_do(arm: orbisim.Scene) -> None:
    state = search(bench_of(arm, BIAS))
    state.declared = state.need(Hypothesis())
    wrong = dataclasses.replace(BIAS, values={"offset": 0.15})
    held = Hypothesis((wrong,), frozen=frozenset({(0, "offset")}))
    found = conclude(state, state.need(held), None)
    assert found.hypothesis.effects[0].values["offset"] == pytest.approx(0.2, rel=0.01)


def test_a_start_from_nothing_that_loses_the_way_is_made_good(
    arm: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = search(bench_of(arm, BIAS))
    known = state.need(Hypothesis((BIAS,)))
    real, calls = state.judge.judge, []

    def lost_at_first(hypothesis: Hypothesis, iterations: int = 5) -> Any:
        found = real(hypothesis, iterations)
        calls.append(found)
        assert found is not None
        if len(calls) > 1:
            return found
        return dataclasses.replace(found, ratio=3 * found.ratio, cost=found.cost + 1e3)

    monkeypatch.setattr(state.judge, "judge", lost_at_first)
    monkeypatch.setattr(state, "renew", lambda hypothesis: None)
    assert state.renewed(known).ratio == pytest.approx(known.ratio, rel=0.05)
    assert len(calls) == 2
    state.renewed(known)
    assert len(calls) == 3  # nothing was lost


def test_the_last_fit_begins_where_the_search_ended_if_it_is_lost() -> None:
    hypothesis = Hypothesis((BIAS,))
    told: list[Any] = []

    def last(ratio: float, contacts: bool = False) -> Any:
        left = iter([(ratio, 900.0), (1.0, 40.0)])

        def judge(which: Hypothesis, iterations: int) -> Any:
            found, cost = next(left)
            return SimpleNamespace(ratio=found, cost=cost)

        bench = SimpleNamespace(contacts=contacts, fit=None)
        told.clear()
        judges: Any = SimpleNamespace(judge=judge, start_from=lambda *known: told.append(known))
        state: Any = SimpleNamespace(bench=bench)
        known: Any = SimpleNamespace()
        return _finally(state, judges, known, hypothesis)

    assert last(2.2).cost == 40.0 and len(told) == 1
    assert last(1.1).cost == 900.0 and not told
    assert last(2.2, contacts=True).cost == 900.0 and len(told) == 1  # it began there


def judged(
    checked: list[float], cost: float, effect: str, *, touching: bool = False, pooled: float = 1.0
) -> Any:
    """What `unpaid` reads of a fitted hypothesis."""
    return SimpleNamespace(
        checked=np.array(checked), fitted=np.array(checked), ratio=1.0, pooled=pooled, cost=cost,
        touching=touching, hypothesis=Hypothesis((EffectInstance(effect, "joint", {}),)),
        fit=SimpleNamespace(count=1000),
    )  # fmt: skip


def test_a_stop_that_only_check_windows_feel_needs_no_criterion() -> None:
    before = judged([1.0, 1.0, 90.0, 80.0], 100.0, "hard_stop")
    after = judged([1.0, 1.0, 2.0, 2.0], 106.0, "hard_stop")
    assert unpaid(Settings(), before, after) is None
    other = judged([1.0, 1.0, 2.0, 2.0], 106.0, "joint_spring")
    assert "criterion" in str(unpaid(Settings(), before, other))


def test_what_acts_in_impacts_alone_pays_if_it_makes_all_windows_good() -> None:
    before = judged([1.0, 1.0, 1.0, 40.0], 100.0, "adhesion", touching=True, pooled=3.3)
    after = judged([1.0, 1.0, 1.0, 1.0], 101.0, "adhesion", touching=True, pooled=1.0)
    assert unpaid(Settings(), before, after) is None
    half = judged([1.0, 1.0, 1.0, 9.0], 101.0, "adhesion", touching=True, pooled=1.7)
    assert unpaid(Settings(), before, half) is not None
    worse = judged([1.0, 1.4, 1.0, 1.0], 101.0, "adhesion", touching=True, pooled=1.05)
    assert unpaid(Settings(), before, worse) is not None


@pytest.mark.slow
def test_a_payload_stands_in_for_the_parts_it_was_found_in(arm: orbisim.Scene) -> None:
    state = search(bench_of(arm, LOAD, LIMIT, noise=1e-3))
    parts = (
        EffectInstance(
            "constant_force", "upper_arm", {"magnitude": 2.6, "x": 1.2, "y": 0.0, "z": -2.3}
        ),
        LIMIT,
        EffectInstance("armature", "shoulder", {"inertia": 0.005}),
    )
    before = state.renewed(state.need(Hypothesis(parts)))
    after = united(state, before)
    names = {(e.effect, e.target) for e in after.hypothesis.effects}
    assert names == {("payload", "upper_arm"), ("torque_saturation", "shoulder")}
    (load,) = (e for e in after.hypothesis.effects if e.effect == "payload")
    assert load.values["mass"] == pytest.approx(0.4, rel=0.1)
    two = state.need(Hypothesis((LOAD, LIMIT)))
    assert united(state, two) is two


def test_joints_and_bodies_need_no_names() -> None:
    unnamed = orbisim.load_scene(
        '<mujoco><worldbody><body><joint axis="0 1 0"/><geom size=".1"/>'
        '<body name="tip" pos="1 0 0"><joint axis="0 1 0"/><geom size=".1"/></body>'
        "</body></worldbody></mujoco>"
    )
    judge = SimpleNamespace(start_from=lambda known: None, glance=lambda hypothesis: 1.0)
    judge.score, judge.check = lambda *given: SimpleNamespace(square=1.0), None
    samples = SimpleNamespace(absolute=np.eye(4), usable=np.ones(4, bool))
    state: Any = SimpleNamespace(
        bench=SimpleNamespace(scene=unnamed, contacts=False, samples=[samples]),
        judge=judge, allowed=lambda instance: True, settings=Settings(),
    )  # fmt: skip
    fewer: Any = SimpleNamespace(hypothesis=Hypothesis())
    parts = [EffectInstance("armature", name, {"inertia": 0.1}) for name in ("joint0", "joint1")]
    assert [one.target for one in _loads(state, fewer, parts)] == ["body1", "tip"]
    shares = np.array([1.0, 0.0])
    assert {one.target for one in stops(state, Hypothesis(), shares)} == {"joint0"}
    play = _structural(state, Hypothesis(), SimpleNamespace(shares=shares))  # type: ignore[arg-type]
    assert {one.target for one in play} == {"joint0"}


def test_simpler_effects_with_masses_retuned_rival_a_payload(arm: orbisim.Scene) -> None:
    offset = EffectInstance(
        "com_offset", "upper_arm", {"offset": 0.01, "x": 0.01, "y": 0.0, "z": 0.0}
    )
    stop = EffectInstance("hard_stop", "elbow", {"position": 1.0, "side": 1.0})
    state: Any = SimpleNamespace(
        bench=SimpleNamespace(scene=arm, contacts=False),
        rivals=[
            Rival(LOAD, 0.0, 1.0, 1, pays=True),
            Rival(offset, 1000.0, 4.0, 1, pays=True),
            Rival(BIAS, 1900.0, 13.0, 1, pays=True),
            Rival(stop, 2000.0, 20.0, 1, pays=False),
        ],
    )
    assert _rivals(state, SimpleNamespace(hypothesis=Hypothesis((LOAD,)))) == [BIAS, offset]  # type: ignore[arg-type]
    assert _rivals(state, SimpleNamespace(hypothesis=Hypothesis((STUCK,)))) == []  # type: ignore[arg-type]


def test_a_resample_without_what_feels_a_parameter_says_nothing() -> None:
    """One window of many feels it: a third of all resamples are without."""
    windows = 12
    information = np.full((windows, 1, 1), 1e-12)
    information[3] = 100.0
    fit = Fit(
        values=np.array([2.0]), start=np.zeros((windows, 2)), square=1.0, penalty=0.0, count=100,
        covariance=np.array([[0.01]]), residual=np.zeros((windows, 4)),
        per_window=np.ones(windows), information=information,
        score=np.where(np.arange(windows)[:, None] == 3, 0.5, 1e-3),
    )  # fmt: skip
    low, high = confidence(fit, ["force"])["force"]
    assert 1.7 < low < 1.81 and 2.19 < high < 2.3
