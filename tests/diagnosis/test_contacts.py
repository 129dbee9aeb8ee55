"""Fits where bodies touch: what is chained through impacts says little, simulations say more."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.bench import Bench, Hypothesis, make_bench
from orbisim.diagnosis.conclusion import doubt
from orbisim.diagnosis.fits import Unknown
from orbisim.diagnosis.gauss_newton import gauss_newton
from orbisim.diagnosis.paying import unpaid
from orbisim.diagnosis.refine import Judge, Judged
from orbisim.diagnosis.retune import REACH, Tunable, retuned
from orbisim.diagnosis.rounds import generalized
from orbisim.diagnosis.samples import prepare_all
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.shooting import Variant
from orbisim.diagnosis.state import SearchState
from orbisim.effects import EffectInstance, add_effects, find
from orbisim.errors import SceneError
from orbisim.testing import inject_effect

HAMMER = """
<mujoco model="hammer">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <body name="head" pos="0 0 0.1">
      <joint name="slide" type="slide" axis="0 0 1" damping="3"/>
      <geom name="head" type="sphere" size="0.05" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><motor name="lift" joint="slide" gear="10" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
GAIN = Tunable("gain", "lift")
DAMPING = Tunable("damping", "slide")
BIAS = EffectInstance("torque_bias", "lift", {"offset": 0.06})


@pytest.fixture(scope="module")
def hammer() -> orbisim.Scene:
    """A mass on a rail that a motor lifts and drops on the floor."""
    return orbisim.load_scene(HAMMER)


def struck(
    hammer: orbisim.Scene, true: orbisim.Scene, effects: list[EffectInstance]
) -> tuple[Bench, Judge, Judged]:
    """Recordings of a scene with effects, for the declared one; and what that leaves."""
    rng = np.random.default_rng(3)
    controls = np.repeat(rng.uniform(-0.2, 1.0, (3, 16, 1)), 25, axis=1)
    runs = inject_effect(
        true, effects, controls=controls, rate=100.0, episodes=3, noise=1e-4, seed=2
    )
    bench = make_bench(hammer, prepare_all(runs, hammer), 0.4)
    assert bench.contacts
    judge = Judge(bench, bench.intervals, most=24)
    nothing = judge.judge(Hypothesis())
    assert nothing is not None and nothing.ratio > 3
    judge.start_from(nothing)
    return bench, judge, nothing


def test_declared_parameters_are_retuned_through_impacts(hammer: orbisim.Scene) -> None:
    true = retuned(hammer, {GAIN: 1.04, DAMPING: 0.97})
    _, judge, _ = struck(hammer, true, [])
    tuned = judge.judge(Hypothesis().tuned([GAIN, DAMPING]))
    assert tuned is not None and tuned.ratio < 1.3
    factors = dict(tuned.hypothesis.factors)
    assert factors[GAIN] == pytest.approx(1.04, abs=0.01)
    assert factors[DAMPING] == pytest.approx(0.97, abs=0.02)


def test_a_glance_tells_how_large_an_effect_should_be(hammer: orbisim.Scene) -> None:
    _, judge, nothing = struck(hammer, hammer, [BIAS])
    right = Hypothesis((BIAS,))
    for offset in (0.03, 0.12):
        other = Hypothesis((BIAS.replace(offset=offset),))
        left, better = judge.sized_glance(other)
        assert better == pytest.approx(0.06 / offset, rel=0.35)
        assert left < nothing.ratio**2
    assert judge.sized_glance(right)[1] == pytest.approx(1.0, abs=0.15)
    assert judge.glance(right) < judge.glance(Hypothesis((BIAS.replace(offset=-0.06),)))


def test_a_glance_lets_retuned_parameters_move(hammer: orbisim.Scene) -> None:
    """Seen from parameters that made up for an effect, its true size leaves nothing."""
    _, judge, _ = struck(hammer, retuned(hammer, {GAIN: 1.03}), [BIAS])
    tuned = judge.judge(Hypothesis().tuned([GAIN, DAMPING]))
    assert tuned is not None and tuned.ratio > 1.5
    judge.start_from(tuned)
    with_it = dataclasses.replace(tuned.hypothesis, effects=(BIAS,))
    without = judge.glance(tuned.hypothesis)
    assert judge.glance(with_it) < 0.3 * without
    assert judge.tried(with_it) < 0.3 * without


def test_without_a_start_a_glance_says_nothing(hammer: orbisim.Scene) -> None:
    bench, _, _ = struck(hammer, hammer, [BIAS])
    assert Judge(bench, bench.intervals).sized_glance(Hypothesis()) == (np.inf, 1.0)


def test_a_glance_does_without_derivatives_that_cannot_be_had(
    hammer: orbisim.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, judge, nothing = struck(hammer, hammer, [BIAS])

    def refuse(*_: Any) -> None:
        raise SceneError("hammer.xml", "MuJoCo refuses it")

    monkeypatch.setattr("orbisim.diagnosis.refine.own_slopes", refuse)
    for _ in range(2):
        left, better = judge.sized_glance(Hypothesis((BIAS,)))
        assert left < nothing.ratio**2 and better == 1.0


def test_a_step_to_an_impossible_scene_is_shortened(arm: orbisim.Scene) -> None:
    """A payload's first step may ask for a negative inertia."""
    friction = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})
    runs = inject_effect(arm, friction, duration=3.0, episodes=2, noise=1e-4, seed=1)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    judge = Judge(bench, bench.intervals)
    refused: list[float] = []

    def build(values: np.ndarray) -> Variant:
        torque = float(values[0])
        if not refused and abs(torque - 0.02) > 0.01:  # the first long step
            refused.append(torque)
            raise SceneError("arm.xml", "MuJoCo refuses it")
        return Hypothesis((friction.replace(torque=torque),)).variant(arm)

    start = Unknown("torque", 0.02, 0.0, 1.0, 1e-4)
    found = gauss_newton(judge.fitted, build, [start], iterations=8)
    assert len(refused) == 1
    assert found.values[0] == pytest.approx(0.1, rel=0.05)


def test_stribeck_friction_can_begin_at_coulomb_friction(hammer: orbisim.Scene) -> None:
    stribeck, model = find("stribeck_friction"), hammer.model
    values = {"coulomb": 5.0, "static": 9.0, "velocity": 0.3}
    coulomb = EffectInstance("coulomb_friction", "slide", {"torque": 2.0})
    (found,) = stribeck.generalized(model, coulomb, values)
    assert found["coulomb"] == 2.0 and found["velocity"] == 0.3
    assert 2.0 < found["static"] < 3.0
    assert stribeck.generalized(model, BIAS, values) == []
    assert stribeck.generalized(model, coulomb) == []  # its velocity is not known
    assert find("torque_bias").generalized(model, coulomb, {"offset": 1.0}) == []


def test_a_payload_can_begin_at_an_offset_of_the_centre_of_mass(hammer: orbisim.Scene) -> None:
    """Each has the same centre of mass as the body with the offset."""
    parts = {"x": 0.01, "y": -0.02, "z": 0.005}
    offset = EffectInstance("com_offset", "head", {"offset": 0.0229, **parts})
    moved = add_effects(hammer, [offset]).model
    found = find("payload").generalized(hammer.model, offset)
    assert len(found) == 4
    for values in found:
        model = add_effects(hammer, [EffectInstance("payload", "head", values)]).model
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        head = model.body("head").id
        place = data.subtree_com[head] - data.xpos[head]
        np.testing.assert_allclose(place, moved.body("head").ipos, atol=1e-9)
    assert find("payload").generalized(hammer.model, BIAS) == []
    heavy = EffectInstance("payload", offset.target, dict(found[0]))
    (back,) = find("com_offset").generalized(hammer.model, heavy)
    assert back == pytest.approx(offset.values, rel=1e-3)
    assert find("com_offset").generalized(hammer.model, BIAS) == []


def judged(checked: list[float], ratio: float, pooled: float, cost: float, touching: bool) -> Any:
    """What `unpaid` reads of a fitted hypothesis."""
    return SimpleNamespace(
        checked=np.array(checked), ratio=ratio, pooled=pooled, cost=cost, touching=touching,
        hypothesis=Hypothesis((BIAS,)), fit=SimpleNamespace(count=10000),
    )  # fmt: skip


def test_what_explains_all_need_not_show_in_windows_that_were_not_fitted() -> None:
    """An event in one window of seven, or in none, where bodies touch."""
    before, after = [1.03, 0.98, 1.2, 6.3, 0.9], [1.02, 0.97, 1.2, 4.0, 0.9]
    settings = Settings()

    def problem(gain: float = 500.0, ratio: float = 1.0, touching: bool = True) -> str | None:
        one = judged(before, 1.2, 1.5, 900.0, touching)
        return unpaid(settings, one, judged(after, ratio, 1.16, 900.0 - gain, touching))

    assert problem() is None
    assert "standard errors" in str(problem(gain=100.0))
    assert problem(ratio=1.12) is None  # no window is worse
    assert "standard errors" in str(problem(touching=False))
    after[4] = 1.2
    assert problem(ratio=1.12) is not None
    worse = judged([1.0, 1.0, 1.04, 1.0], 1.0, 1.0, 400.0, True)
    assert unpaid(settings, judged([1.0, 1.0, 1.0, 1.0], 1.6, 2.2, 900.0, True), worse) is None


def test_declared_parameters_at_the_end_of_their_range_explain_nothing() -> None:
    def of(factor: float) -> Any:
        hypothesis = dataclasses.replace(Hypothesis(), factors=((GAIN, factor),))
        return SimpleNamespace(hypothesis=hypothesis, ratio=1.05)

    assert doubt(of(1.04)) is None
    assert "further off" in str(doubt(of(1 + REACH)))


def test_an_effect_that_paid_stays_while_all_gets_much_worse_without_it() -> None:
    """Where bodies touch, how sure a gain is hangs on a few windows."""

    def kept(cost: float, contacts: bool) -> int:
        fewer = judged([1.0, 60.0, 1.0, 1.0], 5.4, 8.9, cost, contacts)
        state: Any = SearchState.__new__(SearchState)
        state.settings, state.bench = Settings(), SimpleNamespace(contacts=contacts)
        state.judge = SimpleNamespace(judge=lambda hypothesis: fewer)
        both = judged([1.0, 35.0, 1.5, 1.0], 5.2, 5.8, 100.0, contacts)
        both.hypothesis = Hypothesis((BIAS, BIAS.replace(offset=0.1)))
        return len(state.prune(both).hypothesis.effects)

    assert kept(1700.0, True) == 2
    assert kept(150.0, True) == 1
    assert kept(1700.0, False) == 1


def test_a_general_effect_that_did_worse_is_fitted_again_from_its_special_case(
    hammer: orbisim.Scene,
) -> None:
    slide = "slide"
    coulomb = EffectInstance("coulomb_friction", slide, {"torque": 2.0})
    other = EffectInstance("coulomb_friction", "elsewhere", {"torque": 2.0})
    poor = EffectInstance(
        "stribeck_friction", slide, {"coulomb": 9.0, "static": 9.0, "velocity": 0.3}
    )
    state, begun = searching(hammer)

    def again(special: EffectInstance, cost: float) -> int:
        both = [fitted(poor, 100.0), fitted(special, cost)]
        return len(generalized(state, both, Hypothesis().plus, [poor, special]))

    assert again(coulomb, 20.0) == 1
    assert begun[0].effect == "stribeck_friction" and begun[0].values["coulomb"] == 2.0
    assert again(coulomb, 120.0) == 0
    assert again(other, 20.0) == 0


def test_the_best_effect_that_leaves_much_is_generalized(hammer: orbisim.Scene) -> None:
    """A payload was not among the suspects, but an offset of the centre of mass did best."""
    parts = {"x": 0.01, "y": -0.02, "z": 0.005}
    offset = EffectInstance("com_offset", "head", {"offset": 0.0229, **parts})
    state, begun = searching(hammer)
    plus = Hypothesis().plus

    def count(ratio: float, only: tuple[str, ...] | None = None) -> int:
        begun.clear()
        state.settings = Settings(effects=only)
        both = [fitted(offset, 20.0, ratio), fitted(BIAS, 30.0, ratio)]
        return len(generalized(state, both, plus, [offset, BIAS]))

    assert count(9.0) == 1
    masses = [e.values["mass"] for e in begun]
    assert begun[0].effect == "payload" and masses == [pytest.approx(0.15)]  # what `glance` liked
    assert count(1.0) == 0
    assert count(9.0, ("com_offset", "torque_bias")) == 0


def test_what_explains_all_gives_way_to_fewer_numbers_only(hammer: orbisim.Scene) -> None:
    """A payload at a distance, and nothing is left: an offset of the centre of mass may do."""
    place = {"com_x": 0.3, "com_y": -0.1, "com_z": 0.05}
    load = EffectInstance("payload", "head", {"mass": 0.02, **place})
    state, begun = searching(hammer)
    state.judge.glance = lambda hypothesis: 1.0
    generalized(
        state, [fitted(load, 20.0, 1.0), fitted(BIAS, 30.0)], Hypothesis().plus, [load, BIAS]
    )
    assert [one.effect for one in begun] == ["com_offset"]
    assert begun[0].values["x"] > 0 > begun[0].values["y"]


def searching(scene: orbisim.Scene) -> tuple[Any, list[EffectInstance]]:
    """What `generalized` reads of a search, and the effects that were fitted."""
    begun: list[EffectInstance] = []

    def judge(hypothesis: Hypothesis, iterations: int) -> Any:
        begun.append(hypothesis.effects[-1])
        return SimpleNamespace(hypothesis=hypothesis, cost=1.0)

    def glance(hypothesis: Hypothesis) -> float:
        return abs(hypothesis.effects[-1].values.get("mass", 0.0) - 0.2)

    state = SimpleNamespace(
        iterations=4, judge=SimpleNamespace(judge=judge, glance=glance), settings=Settings(),
        bench=SimpleNamespace(scene=scene), done=lambda judged: judged.ratio <= 1.06,
    )  # fmt: skip
    return state, begun


def fitted(one: EffectInstance, cost: float, ratio: float = 9.0) -> Any:
    """An effect, fitted."""
    return SimpleNamespace(hypothesis=Hypothesis((one,)), cost=cost, ratio=ratio)
