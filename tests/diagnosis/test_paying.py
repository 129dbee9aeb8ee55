"""When an effect earns its place on windows that it was not fitted to."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from orbisim.diagnosis.bench import Hypothesis
from orbisim.diagnosis.paying import unpaid
from orbisim.diagnosis.settings import Settings
from orbisim.effects import EffectInstance

SETTINGS = Settings()


def judged(
    checked: list[float], cost: float, touching: bool = False, effect: str = "hard_stop"
) -> Any:
    """What `unpaid` reads of a fitted hypothesis."""
    hypothesis = Hypothesis((EffectInstance(effect, "joint", {}),))
    return SimpleNamespace(
        checked=np.array(checked), ratio=1.5, pooled=10.0, cost=cost, touching=touching,
        hypothesis=hypothesis, fit=SimpleNamespace(count=1000),
    )  # fmt: skip


def test_a_gain_everywhere_pays() -> None:
    before, after = judged([9.0, 8.0, 10.0, 9.0], 900.0), judged([1.0, 1.1, 0.9, 1.0], 100.0)
    assert unpaid(SETTINGS, before, after) is None


def test_no_gain_does_not_pay() -> None:
    before, after = judged([9.0, 8.0, 10.0, 9.0], 900.0), judged([9.1, 8.1, 10.1, 9.0], 100.0)
    assert "no better" in str(unpaid(SETTINGS, before, after))


def test_an_event_in_no_check_window_must_pay_clearly() -> None:
    """A stop that is hit once: windows that choices are checked on cannot tell."""
    checked = [1.0, 1.1, 0.9, 1.0]
    before = judged(checked, 900.0)
    assert unpaid(SETTINGS, before, judged(checked, 800.0)) is None
    assert "do not feel it" in str(unpaid(SETTINGS, before, judged(checked, 870.0)))


def test_added_joints_must_show_in_check_windows() -> None:
    checked = [1.0, 1.1, 0.9, 1.0]
    soft = judged(checked, 100.0, effect="joint_flexibility")
    assert "no better" in str(unpaid(SETTINGS, judged(checked, 900.0), soft))


def test_a_hopeless_window_hides_nothing_where_bodies_touch() -> None:
    before, after = [2.0, 2.2, 1.9, 2.1, 500.0], [1.0, 1.1, 0.9, 1.0, 500.0]
    assert unpaid(SETTINGS, judged(before, 900.0), judged(after, 100.0)) is not None
    assert unpaid(SETTINGS, judged(before, 900.0, True), judged(after, 100.0, True)) is None
