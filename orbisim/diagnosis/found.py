"""What a diagnosis found, piece by piece."""

from __future__ import annotations

import dataclasses
from typing import Literal

from orbisim.effects import EffectInstance

Verdict = Literal["no_residual", "explained", "partly_explained", "unexplained"]


@dataclasses.dataclass(frozen=True)
class Alternative:
    """Another explanation.

    Attributes:
      effect, target: as in the catalogue. delta_bic: how much worse it is.
      reason: why it was not chosen, and what to record to be sure.
      probability: that it belongs in the place of what was chosen, or beside it where nothing was;
        None where that is not known.
    """

    effect: str
    target: str
    delta_bic: float | None
    reason: str
    probability: float | None = None


@dataclasses.dataclass(frozen=True)
class Candidate:
    """An effect that was tried.

    Attributes:
      effect, target: as in the catalogue.
      round: of the search; None if it could not be judged.
      ratio: residual over noise that it leaves.
      delta_bic: how much worse than the best of its round.
      reason: why it was not taken; empty if it was.
    """

    effect: str
    target: str
    round: int | None
    ratio: float | None
    delta_bic: float | None
    reason: str


@dataclasses.dataclass(frozen=True)
class Retuned:
    """A declared parameter that is off. factor: true over declared. ci95: of the factor."""

    label: str
    factor: float
    ci95: tuple[float, float]


@dataclasses.dataclass(frozen=True, eq=False)
class Rival:
    """An effect that was fitted by simulation.

    Attributes:
      instance: with fitted values. delta_bic: twice the log odds by which it is worse than the best
        of its round. ratio: residual over noise that it leaves. round: number of the round.
      reason: why it was not taken; empty for the one that was.
    """

    instance: EffectInstance
    delta_bic: float
    ratio: float
    round: int
    reason: str = ""


@dataclasses.dataclass(frozen=True)
class Term:
    """One number of a combination. effect, target, parameter: as in the catalogue."""

    effect: str
    target: str
    parameter: str
    coefficient: float


@dataclasses.dataclass(frozen=True)
class Combination:
    """Numbers of which only a combination is determined: the sum of all, times their coefficients.

    Attributes:
      terms: the first is of an effect that was found, with coefficient 1.
      value, unit, ci95: of the combination. told: in words.
    """

    terms: tuple[Term, ...]
    value: float
    unit: str
    ci95: tuple[float, float]
    told: str
