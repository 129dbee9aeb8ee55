"""The last word between effects that a round could hardly tell apart: all windows."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.bench import Hypothesis, make_bench
from orbisim.diagnosis.conclusion import doubt, duel, on_contacts, rescaled, scanned, sure
from orbisim.diagnosis.refine import Judge
from orbisim.diagnosis.samples import prepare_all
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.state import Rival
from orbisim.diagnosis.worth import worth
from orbisim.effects import EffectInstance
from orbisim.testing import inject_effect

DELAY = EffectInstance("actuator_delay", "motor", {"delay": 0.02})
LAG = EffectInstance("actuator_lag", "motor", {"time_constant": 0.02})


MOTOR = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/>
<geom name="ball" size=".1"/></body></worldbody>
<actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""


def won_by(costs: dict[str, float], rival: Rival) -> str:
    """The effect that is left of a delay and a rival; the other is told why.

    Args:
      costs: of each effect on all windows; an effect that is not listed must not be tried.
    """

    def judge(hypothesis: Hypothesis, iterations: int) -> Any:
        return SimpleNamespace(hypothesis=hypothesis, cost=costs[hypothesis.effects[-1].effect])

    time, still = np.arange(10.0), np.ones((10, 2))
    moving = SimpleNamespace(time=time, absolute=still, usable=np.ones(10, bool))
    scene = SimpleNamespace(model=mujoco.MjModel.from_xml_string(MOTOR))
    state: Any = SimpleNamespace(
        bench=SimpleNamespace(scene=scene, samples=[moving]),
        rivals=[Rival(DELAY, 0.0, 1.0, 1, pays=True), rival],
        settings=Settings(),
        say=lambda text: None,
    )
    judges: Any = SimpleNamespace(judge=judge, start_from=lambda judged: None)
    after = judge(Hypothesis((DELAY,)), 8)
    winner = str(duel(state, judges, after).hypothesis.effects[-1].effect)
    assert ("on all windows" in state.rivals[0].reason) == (winner != "actuator_delay")
    return winner


NEAR = Rival(LAG, 3.0, 1.0, 1, "it explains less than actuator_delay at motor", pays=True)


def test_a_near_rival_that_is_better_on_all_windows_wins() -> None:
    assert won_by({"actuator_delay": 100.0, "actuator_lag": 80.0}, NEAR) == "actuator_lag"


def test_it_must_be_better_by_more_than_rounding() -> None:
    assert won_by({"actuator_delay": 100.0, "actuator_lag": 99.98}, NEAR) == "actuator_delay"
    assert won_by({"actuator_delay": 100.0, "actuator_lag": 99.0}, NEAR) == "actuator_lag"


def test_with_more_numbers_it_must_be_better_by_a_margin() -> None:
    force = EffectInstance("stribeck_friction", "hinge", {"coulomb": 1.0, "velocity": 0.1})
    rival = dataclasses.replace(NEAR, instance=force)
    assert won_by({"actuator_delay": 100.0, "stribeck_friction": 92.0}, rival) == "actuator_delay"
    assert won_by({"actuator_delay": 100.0, "stribeck_friction": 80.0}, rival) != "actuator_delay"
    costs = {"actuator_delay": 100.0, "stribeck_friction": 8.0}
    for velocity in (1e-4, 3.0):  # Coulomb friction by another name, in motion at 1 rad/s
        rival = dataclasses.replace(NEAR, instance=force.replace(velocity=velocity))
        assert won_by(costs, rival) == "actuator_delay"


def test_those_that_do_not_pay_or_are_far_off_or_of_another_round_are_not_tried() -> None:
    costs = {"actuator_delay": 100.0}
    for change in ({"pays": False}, {"delta_bic": 50.0}, {"round": 2}):
        assert won_by(costs, dataclasses.replace(NEAR, **change)) == "actuator_delay"


def test_final_values_of_a_robust_fit_follow_the_scale_of_what_is_left(arm: orbisim.Scene) -> None:
    """Where the noise is far below what the effects leave, not every residual is an outlier."""
    damping = EffectInstance("viscous_damping", "elbow", {"coefficient": 0.05})
    friction = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})
    runs = inject_effect(arm, [damping, friction], duration=5.0, episodes=3, noise=1e-6, seed=4)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5).whole()
    judge = Judge(bench, bench.intervals, robust=4.0)
    before = judge.judge(Hypothesis((damping,)))
    assert before is not None and before.ratio > 10
    state: Any = SimpleNamespace(
        robust=4.0, bench=bench, intervals=bench.intervals, tunables=(), columns=None
    )
    after = rescaled(state, judge, before)
    left = [float((one.fit.residual**2).sum()) for one in (before, after)]
    assert left[1] < left[0] and (after.ratio, after.cost) == (before.ratio, before.cost)
    state.robust = None
    assert rescaled(state, judge, before) is before


class Rugged:
    """A judge whose fits stay where they begin; the best friction is 0.2."""

    def __init__(self) -> None:
        self.tried: list[float] = []
        self.held: list[bool] = []

    def start_from(self, judged: Any) -> None:
        """Nothing."""

    def judge(self, hypothesis: Hypothesis, iterations: int, polish: bool) -> Any:
        size = hypothesis.effects[0].values["coefficient"]
        self.tried.append(size)
        self.held.append(bool(hypothesis.frozen))
        cost = 5000.0 + 1000.0 * np.log(size / 0.2) ** 2
        return SimpleNamespace(hypothesis=hypothesis, cost=cost, ratio=6.0)


@pytest.mark.parametrize("begin", [0.13, 0.3])
def test_through_impacts_other_sizes_of_a_contact_effect_are_tried(begin: float) -> None:
    scene = orbisim.load_scene(
        '<mujoco><worldbody><geom type="plane" size="1 1 .1"/><body pos="0 0 1"><freejoint/>'
        '<geom name="box" type="box" size=".1 .1 .1"/></body></worldbody></mujoco>'
    )
    slip = EffectInstance("sliding_friction", "box", {"coefficient": begin})
    bench = SimpleNamespace(contacts=True, scene=scene)
    state: Any = SimpleNamespace(bench=bench, say=lambda words: None)
    judge: Any = Rugged()
    after = judge.judge(Hypothesis((slip,)), 5, False)
    found = scanned(state, judge, after)
    (effect,) = found.hypothesis.effects
    assert effect.values["coefficient"] == pytest.approx(0.2, rel=0.04)
    assert not found.hypothesis.frozen  # its interval is that of a free number
    assert sum(judge.held) == len(judge.held) - 3  # one free fit after each of two rows
    assert on_contacts(state, after) == [0]
    bench.contacts = False
    assert scanned(state, judge, after) is after and not on_contacts(state, after)
    bench.contacts, after.ratio = True, 1.2
    assert scanned(state, judge, after) is after


def test_nothing_is_named_for_declared_parameters_alone_where_much_is_left() -> None:
    loaded = Hypothesis((LAG,))
    for ratio, hypothesis, named in ((3.0, Hypothesis(), False), (1.2, Hypothesis(), True),
                                     (300.0, loaded, True)):  # fmt: skip
        after: Any = SimpleNamespace(ratio=ratio, hypothesis=hypothesis)
        assert (doubt(after) is None) == named


def test_effects_that_do_not_surely_predict_are_dropped(arm: orbisim.Scene) -> None:
    """Of two effects on a machine with another one besides; what is left is far above the noise."""
    true = EffectInstance("coulomb_friction", "shoulder", {"torque": 0.3})
    other = EffectInstance("cogging", "elbow", {"amplitude": 0.1, "periods": 3.0, "phase": 0.4})
    runs = inject_effect(arm, [true, other], duration=4.0, episodes=3, noise=1e-5, seed=4)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    judge = Judge(bench, bench.intervals, heavy=True)
    before = judge.judge(Hypothesis())
    idle = EffectInstance("armature", "shoulder", {"inertia": 1e-4})
    after = judge.judge(Hypothesis((true, idle)))
    assert before is not None and after is not None and after.ratio > 10
    state: Any = SimpleNamespace(bench=bench, rejected=[])
    found = sure(state, judge, before, after)
    assert [e.effect for e in found.hypothesis.effects] == ["coulomb_friction"]
    assert "not sure" in state.rejected[0][1]
    alone = judge.judge(Hypothesis((idle,)))
    assert alone is not None and sure(state, judge, before, alone) is before
    assert worth(arm.model, before, found).sure > 20
