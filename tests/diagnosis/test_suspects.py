"""Suspects of two screenings, in turns."""

from __future__ import annotations

import numpy as np

from orbisim.diagnosis.suspects import Screening, Suspect, merged
from orbisim.effects import EffectInstance


def screening(*names: str) -> Screening:
    suspects = tuple(
        Suspect(EffectInstance(name, "hinge", {}), -float(len(names) - i))
        for i, name in enumerate(names)
    )
    return Screening(suspects, np.zeros(1))


def test_in_turns_and_each_once_where_it_is_first() -> None:
    both = merged(screening("a", "b", "c"), screening("b", "d", "a", "e"))
    assert [s.instance.effect for s in both.suspects] == ["a", "b", "d", "c", "e"]


def test_one_of_them_may_be_empty() -> None:
    both = merged(screening(), screening("a", "b"))
    assert [s.instance.effect for s in both.suspects] == ["a", "b"]
