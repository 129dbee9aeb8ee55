"""An effect as it was estimated from data: its parameters with units and intervals."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A parameter. value: SI. unit: its unit. ci95: its 95 % interval; not a number (None in
    reports) where it was not fitted: the data do not determine it."""

    value: float
    unit: str
    ci95: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class FoundEffect:
    """An effect that the scene lacks.

    Attributes:
      effect, target: as in the catalogue. parameters: the first is the one to quote.
      native: whether it is native MJCF in the augmented scene.
      evidence: `held_out_error_without`, `held_out_error_with`, `delta_bic`.
      options: choices that are not numbers.
      error_unit: unit of the errors in `evidence` where they are of a sensor's own readings (root
        mean square); empty where they are the free-running error.
    """

    effect: str
    target: str
    parameters: Mapping[str, Estimate]
    native: bool
    evidence: Mapping[str, float]
    options: Mapping[str, str]
    error_unit: str = ""
