"""What the report says of explanations that were fitted and not taken."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from orbisim.diagnosis.conclusion import rivals_of
from orbisim.diagnosis.explanations import Tried
from orbisim.effects import EffectInstance
from orbisim.evidence import Gain
from orbisim.shooting.hypothesis import Hypothesis


def tried(name: str, gain: float, number: int, reason: str = "") -> Tried:
    hypothesis = Hypothesis((EffectInstance(name, "elbow", {}),) if name else ())
    judged: Any = SimpleNamespace(hypothesis=hypothesis, ratio=2.0)
    return Tried(judged, number, Gain(gain, 1.0, -3.0), reason)


def test_rivals_are_behind_the_best_of_their_round() -> None:
    """By twice the logarithm of the odds; retuned parameters alone are no rival."""
    first = tried("cogging", 50.0, 1), tried("armature", 20.0, 1, "it explains less than cogging")
    again = tried("armature", 10.0, 1, "it explains less")
    found = rivals_of([again, *first, tried("", 60.0, 1), tried("backlash", 5.0, 2)])
    behind = {one.instance.effect: one.delta_bic for one in found}
    assert behind == pytest.approx({"cogging": 20.0, "armature": 80.0, "backlash": 0.0})
    assert [one.reason for one in found] == ["", "it explains less than cogging", ""]
    assert [one.round for one in found] == [1, 1, 2]
