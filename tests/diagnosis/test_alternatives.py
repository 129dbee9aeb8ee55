"""What is said of effects that were fitted and are not in the explanation."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from orbisim.diagnosis.alternatives import alternatives_of
from orbisim.diagnosis.found import Rival
from orbisim.effects import EffectInstance
from orbisim.shooting.hypothesis import Hypothesis

HARDLY = "hardly tells it apart"


def effect(name: str) -> EffectInstance:
    return EffectInstance(name, "elbow", {})


def told(chosen: tuple[str, ...], *rivals: Rival) -> dict[str, str]:
    """The reason of each alternative that was fitted.

    Args:
      chosen: names of the effects that were found.
    """
    hypothesis = Hypothesis(tuple(effect(name) for name in chosen))
    found: Any = SimpleNamespace(
        after=SimpleNamespace(hypothesis=hypothesis), rivals=rivals, rejected=()
    )
    return {a.effect: a.reason for a in alternatives_of(found) if a.delta_bic is not None}


def rival(name: str, behind: float, number: int, reason: str = "it explains less") -> Rival:
    return Rival(effect(name), behind, 3.0, number, reason)


def test_a_rival_close_to_what_was_found() -> None:
    reasons = told(
        ("joint_spring",), rival("joint_spring", 0.0, 1, ""), rival("cogging", 5.0, 1),
        rival("armature", 300.0, 1),
    )  # fmt: skip
    assert HARDLY in reasons["cogging"] and "joint_spring" not in reasons
    assert "it explains less" in reasons["armature"]


def test_the_winner_of_a_round_that_was_dropped_later_is_not_called_close() -> None:
    reasons = told(
        ("joint_spring",), rival("cogging", 0.0, 1, ""), rival("joint_spring", 68.0, 1),
        rival("armature", 75.0, 1), rival("hard_stop", 0.0, 2, ""),
    )  # fmt: skip
    assert "dropped later" in reasons["cogging"] and HARDLY not in reasons["cogging"]
    assert HARDLY in reasons["armature"]  # 7 from the spring
    assert HARDLY not in reasons["hard_stop"]  # a round of which nothing was kept


def test_why_it_was_dropped_is_said_if_it_is_known() -> None:
    swapped = rival("cogging", 528.0, 3, "it explains less than joint_spring at elbow")
    reasons = told(("joint_spring",), rival("cogging", 0.0, 1, ""), swapped)
    assert "less than joint_spring" in reasons["cogging"]


def test_suspects_have_probabilities_in_their_round() -> None:
    hypothesis = Hypothesis(())
    rivals = (rival("cogging", 0.0, 1), rival("armature", 4.0, 1), rival("backlash", 0.0, 2))
    found: Any = SimpleNamespace(
        after=SimpleNamespace(hypothesis=hypothesis), rivals=rivals, rejected=()
    )
    shares = {a.effect: a.probability for a in alternatives_of(found)}
    share = np.exp(-2.0) / (1 + np.exp(-2.0))
    assert shares == pytest.approx(
        {"cogging": 1 - share, "armature": share, "backlash": 1.0}, abs=1e-4
    )
