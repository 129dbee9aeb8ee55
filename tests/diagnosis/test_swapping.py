"""A better effect in the place of one that was found while others were missing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import orbisim
from orbisim.diagnosis.bench import Hypothesis, make_bench
from orbisim.diagnosis.rounds import simpler
from orbisim.diagnosis.samples import prepare_all
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.state import Rival, SearchState
from orbisim.diagnosis.swapping import swapped
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


def test_of_equals_the_one_with_fewest_numbers_then_the_first_in_the_catalogue(
    arm: orbisim.Scene,
) -> None:
    ranked = sorted(
        (Hypothesis((STRIBECK,)), Hypothesis((BIAS,)), Hypothesis((COULOMB,))),
        key=lambda hypothesis: simpler(arm.model, hypothesis),
    )
    assert [h.effects[0].effect for h in ranked][-1] == "stribeck_friction"
    assert ranked[0].effects[0].effect == "coulomb_friction"


LINEAR = EffectInstance("linear_drag", "ball", {"coefficient": 0.06})
SQUARE = EffectInstance("quadratic_drag", "ball", {"coefficient": 0.004})
FORCE = EffectInstance("constant_force", "ball", {"magnitude": 0.0, "x": 0.0, "y": 0.0, "z": 0.0})
LOAD = EffectInstance("payload", "ball", {"mass": 0.04, "com_x": 0.0, "com_y": 0.0, "com_z": 0.0})


class Touching:
    """A search where bodies touch, in which hypotheses cost what their last effect costs."""

    def __init__(self, costs: dict[str, float], done: bool = False) -> None:
        self.costs, self.round, self.late, self.iterations = costs, 2, False, 4
        self.bench, self.settings = SimpleNamespace(contacts=True), Settings()
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
