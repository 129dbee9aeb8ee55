"""The last word between effects that a round could hardly tell apart: all windows."""

import dataclasses
from types import SimpleNamespace
from typing import Any

from orbisim.diagnosis.bench import Hypothesis
from orbisim.diagnosis.conclusion import duel
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.state import Rival
from orbisim.effects import EffectInstance

DELAY = EffectInstance("actuator_delay", "motor", {"delay": 0.02})
LAG = EffectInstance("actuator_lag", "motor", {"time_constant": 0.02})


def won_by(costs: dict[str, float], rival: Rival) -> str:
    """The effect that is left of a delay and a rival.

    Args:
      costs: of each effect on all windows; an effect that is not listed must not be tried.
    """

    def judge(hypothesis: Hypothesis, iterations: int) -> Any:
        return SimpleNamespace(hypothesis=hypothesis, cost=costs[hypothesis.effects[-1].effect])

    state: Any = SimpleNamespace(
        rivals=[Rival(DELAY, 0.0, 1.0, 1, pays=True), rival],
        settings=Settings(),
        say=lambda text: None,
    )
    judges: Any = SimpleNamespace(judge=judge, start_from=lambda judged: None)
    after = judge(Hypothesis((DELAY,)), 8)
    return str(duel(state, judges, after).hypothesis.effects[-1].effect)


NEAR = Rival(LAG, 3.0, 1.0, 1, "it explains less than actuator_delay at motor", pays=True)


def test_a_near_rival_that_is_better_on_all_windows_wins() -> None:
    assert won_by({"actuator_delay": 100.0, "actuator_lag": 80.0}, NEAR) == "actuator_lag"


def test_it_must_be_better_by_more_than_chance() -> None:
    assert won_by({"actuator_delay": 100.0, "actuator_lag": 98.0}, NEAR) == "actuator_delay"


def test_those_that_do_not_pay_or_are_far_off_or_of_another_round_are_not_tried() -> None:
    costs = {"actuator_delay": 100.0}
    for change in ({"pays": False}, {"delta_bic": 50.0}, {"round": 2}):
        assert won_by(costs, dataclasses.replace(NEAR, **change)) == "actuator_delay"
