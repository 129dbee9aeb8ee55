"""Windows: stretches of recordings that are simulated freely, each from a start of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]


@dataclasses.dataclass(frozen=True, eq=False)
class Windows:
    """Consecutive usable intervals of one recording each.

    Attributes:
      first: [W] number of the first interval. length: number of intervals of every window.
      recording: [W]. horizon: [W, 2 nv] samples after the start at which each position and velocity
        can be predicted; all if None.
    """

    first: Ints
    length: int
    recording: Ints
    horizon: Ints | None = None

    def __len__(self) -> int:
        return len(self.first)

    def some(self, keep: Bools | Ints) -> Windows:
        """The chosen windows, marked or by their numbers."""
        horizon = None if self.horizon is None else self.horizon[keep]
        return Windows(self.first[keep], self.length, self.recording[keep], horizon)

    def reach(self) -> Ints:
        """[W]: number of intervals that can be predicted."""
        if self.horizon is None:
            return np.full(len(self), self.length)
        return np.minimum(self.horizon.max(axis=1), self.length)

    def fragile(self) -> Bools:
        """[W]: windows that end early, as impacts make what follows uncertain."""
        if self.horizon is None:
            return np.zeros(len(self), bool)
        return np.asarray((self.horizon < self.length).any(axis=1))

    def predictable(self) -> Bools:
        """[W, length + 1, 2 nv] or [W, length + 1, 1]: what lies within the horizon."""
        steps = np.arange(self.length + 1)[:, None]
        if self.horizon is None:
            return np.ones((len(self), self.length + 1, 1), bool)
        return np.asarray(steps <= self.horizon[:, None])


def cut_windows(recording: Ints, row: Ints, length: int, avoid: Bools | None = None) -> Windows:
    """Cuts runs of consecutive intervals into windows of the same length.

    A run that is no multiple of it gives a last window that overlaps the one before.

    Args:
      recording, row: [N] of the intervals. avoid: [N] where no window should start.
    """
    firsts: list[int] = []
    for start, stop in runs_of(recording, row):
        begin = start
        while begin + length <= stop:
            while avoid is not None and avoid[begin] and begin + length < stop:
                begin += 1
            firsts.append(begin)
            begin += length
        left = stop - begin
        last = firsts[-1] if firsts else -1
        if left > length // 2 and stop - length >= start and stop - length > last:
            firsts.append(stop - length)
    first = np.array(firsts, np.int64)
    return Windows(first, length, recording[first] if len(first) else first)


def runs_of(recording: Ints, row: Ints) -> Iterator[tuple[int, int]]:
    """Ranges of intervals that follow one another."""
    if not len(row):
        return
    joined = (np.diff(recording) == 0) & (np.diff(row) == 1)
    breaks = np.flatnonzero(~joined) + 1
    yield from zip([0, *breaks], [*breaks, len(row)], strict=True)


def chosen(predictable: Bools, measured: Ints) -> Bools:
    """The measured ones of all positions and velocities."""
    return predictable if predictable.shape[2] == 1 else predictable[:, :, measured]


def evenly(keep: Bools, most: int | None) -> Bools:
    """At most so many of the marked ones, spread evenly; all if None."""
    marked = np.flatnonzero(keep)
    if most is None or len(marked) <= most:
        return keep
    kept = np.zeros_like(keep)
    kept[marked[np.unique(np.linspace(0, len(marked) - 1, most).round().astype(int))]] = True
    return kept


def hats_at(places: Floats, length: int) -> Floats:
    """[length, knots]: shares of the knots in each interval of what is linear between them.

    Args:
      places: [knots] numbers of intervals, equally far apart.
    """
    away = np.abs(np.arange(length)[:, None] - places)
    return np.asarray(np.clip(1 - away / (places[1] - places[0]), 0, None))
