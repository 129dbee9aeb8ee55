"""What a screening finds, and how two screenings become one."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from orbisim.effects import EffectInstance

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Suspect:
    """An effect that may be missing, with values to start a fit from.

    Attributes:
      instance: the effect. bic: difference of the Bayesian information criterion to no effect, in
        linear approximation (negative is better); zero where no regression has ranked it.
      moved: what the free parameters of the effects that are there already change by then; None if
        that is not known.
      sized: the effect so many times as large; None if that cannot be.
    """

    instance: EffectInstance
    bic: float = 0.0
    moved: Floats | None = None
    sized: Callable[[float], EffectInstance | None] = lambda _: None

    @property
    def place(self) -> tuple[str, str]:
        """Effect and target."""
        return (self.instance.effect, self.instance.target)


@dataclasses.dataclass(frozen=True, eq=False)
class Screening:
    """Result of a screening. All suspects are possible, with values within their bounds.

    Attributes:
      suspects: best first, one for each effect, target and options.
      shares: [nv] share of the residual that a missing force at each degree of freedom explains.
      tuned: suspects when declared parameters may be retuned too.
    """

    suspects: tuple[Suspect, ...]
    shares: Floats
    tuned: tuple[Suspect, ...] = ()


def merged(one: Screening, other: Screening) -> Screening:
    """Two screenings of the same data, along different motions or with windows weighed otherwise:
    suspects of both, in turns."""
    return dataclasses.replace(
        one,
        suspects=in_turns(one.suspects, other.suspects, lambda s: key_of(s.instance)),
        tuned=in_turns(one.tuned, other.tuned, lambda s: key_of(s.instance)),
    )


T = TypeVar("T")


def in_turns(one: Sequence[T], other: Sequence[T], key: Callable[[T], Any]) -> tuple[T, ...]:
    """Both sequences, element by element; what was there before is left out.

    Args:
      key: what makes two elements the same.
    """
    both = itertools.chain.from_iterable(itertools.zip_longest(one, other))
    found: dict[Any, T] = {}
    for item in both:
        if item is not None:
            found.setdefault(key(item), item)
    return tuple(found.values())


def key_of(instance: EffectInstance) -> tuple[str, ...]:
    """Effect, target and options: suspects of the same key differ in values alone."""
    return (instance.effect, instance.target, *sorted(instance.options.values()))
