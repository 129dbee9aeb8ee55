"""Windows: stretches of recordings that are simulated freely, each from a start of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

Ints = npt.NDArray[np.int64]


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

    def some(self, keep: npt.NDArray[np.bool_] | Ints) -> Windows:
        """The chosen windows, marked or by their numbers."""
        horizon = None if self.horizon is None else self.horizon[keep]
        return Windows(self.first[keep], self.length, self.recording[keep], horizon)

    def reach(self) -> Ints:
        """[W]: number of intervals that can be predicted."""
        if self.horizon is None:
            return np.full(len(self), self.length)
        return np.minimum(self.horizon.max(axis=1), self.length)

    def fragile(self) -> npt.NDArray[np.bool_]:
        """[W]: windows that end early, as impacts make what follows uncertain."""
        if self.horizon is None:
            return np.zeros(len(self), bool)
        return np.asarray((self.horizon < self.length).any(axis=1))

    def predictable(self) -> npt.NDArray[np.bool_]:
        """[W, length + 1, 2 nv] or [W, length + 1, 1]: what lies within the horizon."""
        steps = np.arange(self.length + 1)[:, None]
        if self.horizon is None:
            return np.ones((len(self), self.length + 1, 1), bool)
        return np.asarray(steps <= self.horizon[:, None])


def cut_windows(
    recording: Ints, row: Ints, length: int, avoid: npt.NDArray[np.bool_] | None = None
) -> Windows:
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


def chosen(predictable: npt.NDArray[np.bool_], measured: Ints) -> npt.NDArray[np.bool_]:
    """The measured ones of all positions and velocities."""
    return predictable if predictable.shape[2] == 1 else predictable[:, :, measured]
