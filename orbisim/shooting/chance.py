"""What effects that an explanation does not have explain of what it leaves, by chance."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from orbisim.effects.screening import Candidate, Column
from orbisim.evidence import independent_by_chance
from orbisim.motion.linear import Intervals
from orbisim.shooting.bench import Bench
from orbisim.shooting.regress import WeightedData, projected, stacked
from orbisim.shooting.windows import Windows

Floats = npt.NDArray[np.float64]
Place = tuple[str, str]


@dataclasses.dataclass(frozen=True, eq=False)
class Chance:
    """Columns of effects at their targets along a motion.

    Attributes:
      intervals: the linear system. columns: of effects. places: effect and target of each column.
    """

    intervals: Intervals
    columns: tuple[Column, ...]
    places: tuple[Place, ...]

    def design(self, bench: Bench, windows: Windows) -> Floats:
        """[W, R, C]: weighted columns over windows, starts projected out."""
        inputs, signals = stacked(self.intervals, self.columns)
        data = WeightedData(bench.samples, self.intervals, bench.noise, None)
        parts = projected(self.intervals, windows, inputs, signals, data)
        return np.array([part.design for part in parts])

    def independent(
        self, design: Floats, left: Floats, weight: Floats, there: Sequence[Place]
    ) -> float:
        """How many data count as independent (`orbisim.evidence.independent_by_chance`).

        Args:
          design: as above. left: [W, R] what is left. weight: [W] by which windows count.
          there: effects of the explanation, with targets: their columns are fitted away.
        """
        own = np.array([place in set(there) for place in self.places], bool)
        return independent_by_chance(design[..., ~own], left, weight, design[..., own])


def chance_of(intervals: Intervals, found: Sequence[Candidate]) -> Chance | None:
    """One form of each candidate, evenly spread where there are many; None if there is none."""
    first: dict[Place, Candidate] = {}
    for one in found:
        first.setdefault((one.effect, one.target), one)
    every = [(c, place) for place, one in first.items() for c in one.columns[:_FORM]]
    if not every:
        return None
    some = np.unique(np.linspace(0, len(every) - 1, _MOST).round().astype(int))
    columns, places = zip(*(every[i] for i in some), strict=True)
    return Chance(intervals, columns, places)


_FORM = 4
"""Columns of an effect: mass and first moments of a body."""
_MOST = 60
"""Columns: they span some ten to thirty directions."""
