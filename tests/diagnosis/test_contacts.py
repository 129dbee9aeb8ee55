"""Fits where bodies touch: what is chained through impacts says little, simulations say more."""

from __future__ import annotations

import dataclasses
from typing import Any

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance, add_effects, find
from orbisim.errors import SceneError
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judge, Judged
from orbisim.shooting.retune import Tunable, retuned
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
    return bench, judge, nothing


@pytest.fixture(scope="module")
def pushed(hammer: orbisim.Scene) -> tuple[Judge, Judged]:
    """Recordings with a bias, and what the declared scene leaves of them."""
    _, judge, nothing = struck(hammer, hammer, [BIAS])
    return judge, nothing


def test_declared_parameters_are_retuned_through_impacts(hammer: orbisim.Scene) -> None:
    true = retuned(hammer, {GAIN: 1.04, DAMPING: 0.97})
    _, judge, nothing = struck(hammer, true, [])
    tuned = judge.judge(Hypothesis().tuned([GAIN, DAMPING]), begin=judge.begin(nothing))
    assert tuned is not None and tuned.ratio < 1.3
    factors = dict(tuned.hypothesis.factors)
    assert factors[GAIN] == pytest.approx(1.04, abs=0.01)
    assert factors[DAMPING] == pytest.approx(0.97, abs=0.02)


def test_a_glance_tells_how_large_an_effect_should_be(pushed: tuple[Judge, Judged]) -> None:
    judge, nothing = pushed
    begin = judge.begin(nothing)
    right = Hypothesis((BIAS,))
    for offset in (0.03, 0.12):
        other = Hypothesis((BIAS.replace(offset=offset),))
        left, better = judge.sized_glance(other, begin)
        assert better == pytest.approx(0.06 / offset, rel=0.35)
        assert left < nothing.ratio**2
    assert judge.sized_glance(right, begin)[1] == pytest.approx(1.0, abs=0.15)
    wrong = Hypothesis((BIAS.replace(offset=-0.06),))
    assert judge.glance(right, begin) < judge.glance(wrong, begin)


def test_a_glance_lets_retuned_parameters_move(hammer: orbisim.Scene) -> None:
    """Seen from parameters that made up for an effect, its true size leaves nothing."""
    _, judge, nothing = struck(hammer, retuned(hammer, {GAIN: 1.03}), [BIAS])
    tuned = judge.judge(Hypothesis().tuned([GAIN, DAMPING]), begin=judge.begin(nothing))
    assert tuned is not None and tuned.ratio > 1.5
    begin = judge.begin(tuned)
    with_it = dataclasses.replace(tuned.hypothesis, effects=(BIAS,))
    without = judge.glance(tuned.hypothesis, begin)
    assert judge.glance(with_it, begin) < 0.3 * without
    assert judge.tried(with_it, begin) < 0.3 * without


def test_without_a_start_a_glance_says_nothing(pushed: tuple[Judge, Judged]) -> None:
    judge, _ = pushed
    assert judge.sized_glance(Hypothesis(), judge.cold) == (np.inf, 1.0)


def test_a_glance_does_without_derivatives_that_cannot_be_had(
    pushed: tuple[Judge, Judged], monkeypatch: pytest.MonkeyPatch
) -> None:
    judge, nothing = pushed

    def refuse(*_: Any) -> None:
        raise SceneError("hammer.xml", "MuJoCo refuses it")

    monkeypatch.setattr("orbisim.shooting.judge.own_slopes", refuse)
    begin = dataclasses.replace(judge.begin(nothing))
    left, better = judge.sized_glance(Hypothesis((BIAS,)), begin)
    assert left < nothing.ratio**2 and better == 1.0


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
