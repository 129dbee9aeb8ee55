"""A better effect in the place of one that was found while others were missing."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.bench import Hypothesis, make_bench
from orbisim.diagnosis.paying import unpaid
from orbisim.diagnosis.rounds import ranked
from orbisim.diagnosis.run import bad_windows
from orbisim.diagnosis.samples import prepare_all
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.state import Rival, SearchState
from orbisim.diagnosis.swapping import swapped
from orbisim.diagnosis.twins import twins
from orbisim.effects import EffectInstance
from orbisim.testing import inject_effect

DAMPING = EffectInstance("viscous_damping", "elbow", {"coefficient": 0.05})
BIAS = EffectInstance("torque_bias", "elbow", {"offset": 0.2})
SOFT = EffectInstance("joint_spring", "elbow", {"stiffness": 2e-3, "rest_position": 100.0})
STRIBECK = EffectInstance(
    "stribeck_friction", "elbow", {"coulomb": 0.1, "static": 0.1, "velocity": 0.1}
)
COULOMB = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})


def searched(arm: orbisim.Scene) -> SearchState:
    runs = inject_effect(arm, [DAMPING, BIAS], duration=4.0, episodes=3, noise=1e-4, seed=4)
    return SearchState(make_bench(arm, prepare_all(runs, arm), 0.5), Settings(), lambda _: None)


def test_a_spring_that_only_pushes_gives_way_to_an_offset(arm: orbisim.Scene) -> None:
    state = searched(arm)
    before = state.need(Hypothesis((SOFT, DAMPING)))
    after = swapped(state, before)
    assert {e.effect for e in after.hypothesis.effects} == {"viscous_damping", "torque_bias"}
    offset = next(e for e in after.hypothesis.effects if e.effect == "torque_bias")
    assert abs(offset.values["offset"] - 0.2) < 0.01
    told = [r for r in state.rivals if r.instance.effect == "joint_spring"]
    assert "torque_bias at elbow" in told[-1].reason


def test_one_effect_alone_and_the_right_ones_stay(arm: orbisim.Scene) -> None:
    state = searched(arm)
    single = state.need(Hypothesis((BIAS,)))
    assert swapped(state, single) is single
    right = state.need(Hypothesis((BIAS, DAMPING)))
    assert swapped(state, right) is right


def order(arm: orbisim.Scene, *costs: tuple[EffectInstance, float]) -> list[str]:
    """Names of effects, ranked after a round in which they cost what they do."""
    every: Any = [fitted(one, cost) for one, cost in costs]
    none: Any = fitted(BIAS, 900.0)
    return [j.hypothesis.effects[0].effect for j in ranked(arm.model, every, none)]


def fitted(one: EffectInstance, cost: float, fit: float = 1.0, worst: float = 1.0) -> Any:
    """An effect where bodies touch; the worst window is as bad as it says."""
    windows = np.array([1.0, 1.0, worst])
    return SimpleNamespace(
        hypothesis=Hypothesis((one,)), cost=cost, ratio=1.0, touching=True,
        pooled=float(np.sqrt(windows.mean())), checked=windows, fitted=windows,
        fit=SimpleNamespace(count=1000),
    )  # fmt: skip


def test_of_equals_the_one_with_fewest_numbers_then_the_better_one(arm: orbisim.Scene) -> None:
    even = order(arm, (STRIBECK, 99.0), (BIAS, 101.0), (COULOMB, 100.0))
    assert even == ["coulomb_friction", "torque_bias", "stribeck_friction"]
    assert (
        order(arm, (BIAS, 100.0), (COULOMB, 100.001))[0] == "coulomb_friction"
    )  # the same physics
    assert order(arm, (STRIBECK, 90.0), (COULOMB, 100.0))[0] == "stribeck_friction"


def test_a_stop_that_settles_the_few_bad_windows_comes_first(arm: orbisim.Scene) -> None:
    stop = EffectInstance("hard_stop", "elbow", {"position": 0.4, "side": 1.0})
    before, after = fitted(COULOMB, 100.0, worst=30.0), fitted(stop, 110.0)
    assert [j.cost for j in ranked(arm.model, [fitted(BIAS, 90.0, worst=29.0), after], before)] == [
        110.0, 90.0,
    ]  # fmt: skip
    assert unpaid(Settings(), before, after) is None
    other = fitted(dataclasses.replace(stop, effect="backlash"), 110.0)
    assert unpaid(Settings(), before, other) is not None  # what acts all the time must show it
    even = fitted(COULOMB, 100.0, worst=1.2)  # nothing is bad
    assert unpaid(Settings(), even, after) is not None
    after.checked = np.array([1.0, 1.3, 1.0])  # a window is worse than before
    assert unpaid(Settings(), before, after) is not None


SERVO = """<mujoco><worldbody>
<body name="ball"><freejoint name="ball"/><geom name="ball" size=".1"/></body>
<body name="carriage"><joint name="x" type="slide" axis="1 0 0"/><geom size=".1"/>
<body name="hand"><joint name="y" type="slide" axis="0 1 0"/><geom size=".1"/></body></body>
</worldbody><actuator><position name="pull" joint="y" kp="50" gear="2"/></actuator></mujoco>"""

LINEAR = EffectInstance("linear_drag", "ball", {"coefficient": 0.06})
SQUARE = EffectInstance("quadratic_drag", "ball", {"coefficient": 0.004})
FORCE = EffectInstance("constant_force", "ball", {"magnitude": 0.0, "x": 0.0, "y": 0.0, "z": 0.0})
LOAD = EffectInstance("payload", "ball", {"mass": 0.04, "com_x": 0.0, "com_y": 0.0, "com_z": 0.0})


class Touching:
    """A search where bodies touch, in which hypotheses cost what their last effect costs."""

    def __init__(self, costs: dict[str, float], done: bool = False) -> None:
        self.costs, self.round, self.late, self.iterations = costs, 2, False, 4
        scene = orbisim.load_scene(SERVO)
        self.bench = SimpleNamespace(contacts=True, scene=scene, samples=[])
        self.settings = Settings()
        self.fitted: list[str] = []
        self.judge: Any = SimpleNamespace(judge=self._judge, start_from=lambda judged: None)
        self.done = lambda judged: done
        self.rivals = [
            Rival(one, 10.0 * i, 9.0, number, "" if one is LINEAR else "less", pays=True)
            for i, (one, number) in enumerate([(LINEAR, 2), (FORCE, 2), (SQUARE, 2), (SQUARE, 1)])
        ]

    def _judge(self, hypothesis: Hypothesis, iterations: int) -> Any:
        name = hypothesis.effects[-1].effect
        self.fitted.append(name)
        return SimpleNamespace(hypothesis=hypothesis, cost=self.costs[name], ratio=1.0)

    def allowed(self, instance: EffectInstance) -> bool:
        """Everything."""
        return True

    def say(self, words: str) -> None:
        """Nothing."""

    def settled(self, judged: Any) -> Any:
        """Fitted to the end."""
        return judged

    renewed = prune = settled


def exchanged(costs: dict[str, float], done: bool = False) -> tuple[list[str], Touching]:
    """The effects afterwards, of a payload and a linear drag."""
    state: Any = Touching(costs, done)
    current: Any = SimpleNamespace(hypothesis=Hypothesis((LOAD, LINEAR)), cost=3000.0, ratio=7.0)
    return [e.effect for e in swapped(state, current).hypothesis.effects], state


def test_where_bodies_touch_the_last_effect_gives_way_to_one_of_its_family() -> None:
    found, state = exchanged({"quadratic_drag": 30.0, "constant_force": 20.0})
    assert found == ["payload", "quadratic_drag"]
    assert state.fitted == ["quadratic_drag"]  # the force is of another family
    now = {(r.instance.effect, r.round): r.reason for r in state.rivals}
    assert now["quadratic_drag", 2] == "" and now["quadratic_drag", 1] == "less"
    assert "quadratic_drag at ball" in now["linear_drag", 2]


def test_it_stays_where_the_other_is_no_better_or_nothing_is_left() -> None:
    found, state = exchanged({"quadratic_drag": 2995.0})
    assert found == ["payload", "linear_drag"]
    assert state.rivals[0].reason == ""
    found, state = exchanged({"quadratic_drag": 30.0}, done=True)
    assert found == ["payload", "linear_drag"] and state.fitted == []


def test_what_is_bad_in_few_windows_is_said() -> None:
    declared: Any = SimpleNamespace(fitted=np.array([1.0, 36.0]), checked=np.array([0.9, 4.0]))
    assert bad_windows(declared).startswith(
        "2 of 4 windows miss by more than 1.5 times the noise (up to 6 times)"
    )


def test_offsets_at_a_servo_are_twins() -> None:
    """A servo of 50 N/m with a gear of 2, whose command is in units of the gear's output."""
    model = orbisim.load_scene(SERVO).model
    bias = EffectInstance("sensor_bias", "y", {"offset": 0.01})
    (push,) = twins(model, bias)
    assert (push.effect, push.target) == ("torque_bias", "pull")
    assert push.values["offset"] == pytest.approx(50 * 2 * 0.01)
    (back,) = twins(model, push)
    assert (back.effect, back.target) == ("sensor_bias", "y")
    assert back.values["offset"] == pytest.approx(0.01)
    parts = {"magnitude": 2.0, "x": 0.0, "y": 2.0, "z": 0.0}
    both = twins(model, EffectInstance("constant_force", "hand", parts))
    assert {e.effect: e.values["offset"] for e in both} == pytest.approx(
        {"torque_bias": 1.0, "sensor_bias": 0.01}
    )
    parts = {"magnitude": 2.0, "x": 2.0, "y": 0.0, "z": 0.0}
    assert twins(model, EffectInstance("constant_force", "hand", parts)) == []  # no servo there
    assert twins(model, EffectInstance("sensor_bias", "x", {"offset": 0.01})) == []
    assert twins(model, LINEAR) == []


def test_a_twin_is_tried_even_if_nothing_is_left() -> None:
    bias = EffectInstance("torque_bias", "pull", {"offset": 1.0})
    state: Any = Touching({"sensor_bias": 2990.0}, done=True)
    state.rivals = [Rival(bias, 0.0, 1.0, 2, pays=True)]
    current: Any = SimpleNamespace(hypothesis=Hypothesis((bias,)), cost=3000.0, ratio=1.0)
    (found,) = swapped(state, current).hypothesis.effects
    assert (found.effect, found.target) == ("sensor_bias", "y")
    assert "sensor_bias at y" in state.rivals[0].reason
