"""Windows: stretches of recordings that are simulated freely, each from a start of its own."""

from __future__ import annotations

import copy
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
      scatter: [W, length + 1, 2 nv] standard deviation of what impacts leave unknown of predictions
        (`orbisim.shooting.impacts`), in units of the noise; none if None.
    """

    first: Ints
    length: int
    recording: Ints
    horizon: Ints | None = None
    scatter: Floats | None = None

    def __len__(self) -> int:
        return len(self.first)

    def some(self, keep: Bools | Ints) -> Windows:
        """The chosen windows, marked or by their numbers."""
        horizon = None if self.horizon is None else self.horizon[keep]
        scatter = None if self.scatter is None else self.scatter[keep]
        return Windows(self.first[keep], self.length, self.recording[keep], horizon, scatter)

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


class Whitening:
    """Makes weighted data of windows independent again where impacts leave predictions unknown.

    What the model predicts of a signal through an impact is off by c standard deviations of the
    noise, half of the variance (`_TOGETHER`) alike over the window (another impulse moves all that
    comes after it), half of it by itself at each sample (another time of the impact). The data's
    covariance in units of the noise is 1 + diag(c^2) / 2 + c c' / 2, and its inverse square root is
    that of the diagonal part and of a matrix of rank one.

    Args:
      scatter: [W, K + 1, ny] as of `Windows`, of what is measured. seen: [W, K + 1, ny].
    """

    def __init__(self, scatter: Floats, seen: Bools) -> None:
        size = np.where(seen, np.minimum(scatter, _NOTHING_SAID), 0.0)
        self._scale = 1.0 / np.sqrt(1.0 + (1.0 - _TOGETHER) * size**2)
        along = np.sqrt(_TOGETHER) * size * self._scale
        square = (along**2).sum(axis=1, keepdims=True)
        length = np.sqrt(np.maximum(square, 1e-300))
        self._along = along / length
        self._kept = 1.0 - 1.0 / np.sqrt(1.0 + square[:, 0])

    def some(self, which: Ints) -> Whitening:
        """Of the windows of these numbers."""
        part = copy.copy(self)
        part._scale, part._along = self._scale[which], self._along[which]
        part._kept = self._kept[which]
        return part

    def __call__(self, values: Floats) -> Floats:
        """Weighted data [W, K + 1, ny, ...], or columns of them, whitened."""
        extra = (1,) * (values.ndim - 3)
        values = values * self._scale.reshape(*self._scale.shape, *extra)
        along = self._along.reshape(*self._along.shape, *extra)
        inner = (along * values).sum(axis=1) * self._kept.reshape(*self._kept.shape, *extra)
        return np.asarray(values - along * inner[:, None])


_TOGETHER = 0.5
"""Share of the variance that is alike over a window. What impacts do lies between a course that is
off by one impulse and one that is off at each sample anew; with either alone, the other would be
taken for what is missing."""
_NOTHING_SAID = 1e6
"""Scatter of what nothing is said of: its square is a number still."""


def whitening_of(windows: Windows, measured: Ints, seen: Bools) -> Whitening | None:
    """For the measured ones of all positions and velocities; None where nothing scatters."""
    if windows.scatter is None or not windows.scatter.any():
        return None
    return Whitening(windows.scatter[:, :, measured], seen)


def start_size(noise: tuple[Floats, Floats], step: float) -> Floats:
    """[2 nv]: what the noise leaves unknown of a window's start; velocities that are not measured
    by differences of positions.

    Args:
      noise: standard deviations of positions and velocities. step: typical time between samples, s.
    """
    sigma = np.concatenate(noise)
    from_positions = np.concatenate([noise[0], noise[0] / (4 * step)])
    size = np.where(np.isfinite(sigma), sigma, from_positions)
    return np.where(np.isfinite(size), size, size[np.isfinite(size)].max(initial=0.0))


KNOWN = 0.5
"""Error of a window's start over what one sample leaves unknown of it (`start_size`): a fit knows
it better than a sample does."""


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
