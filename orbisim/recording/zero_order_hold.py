"""Controls that are held between samples, as a simulation with steps of its own sees them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

SNAP = 1e-6
"""Part of a step within which a sample counts as falling on the border of the step."""


def filled(values: Floats) -> Floats:
    """Missing samples [T, n] filled with the one before, at the start with the first one.

    A column without samples stays NaN.
    """
    seen = np.isfinite(values)
    if seen.all():
        return values
    last = np.maximum.accumulate(np.where(seen, np.arange(len(values))[:, None], -1), axis=0)
    last = np.where(last < 0, seen.argmax(axis=0), last)
    return np.asarray(np.take_along_axis(values, last, axis=0))


def led(values: Floats, share: float | Floats, parts: int = 1) -> Floats:
    """[T, parts, ...]: means, over equal parts of each interval between samples, of a signal that
    changes before the sample that logs it, or after.

    Args:
      values: [T, ...] the signal at the samples.
      share: of a sampling interval, -1 to 1, by which each change comes before its sample: of all,
        or [T - 1] of each. The last value stays, the first one does where changes come after
        their samples, and so does one beside a missing one (NaN).
      parts: of each interval.
    """
    values = np.asarray(values, np.float64)
    shape = (1,) * (values.ndim - 1)
    early = np.broadcast_to(np.maximum(share, 0.0), len(values) - 1).reshape(-1, 1, *shape)
    late = np.broadcast_to(np.maximum(np.negative(share), 0.0), len(values) - 1)
    late = late.reshape(-1, 1, *shape)
    change = values[1:] - values[:-1]
    known = np.where(np.isfinite(change), change, 0.0)[:, None]
    ends = np.arange(1, parts + 1).reshape(1, -1, *shape)
    found = np.repeat(values[:, None], parts, axis=1)
    found[:-1] += np.clip(ends - parts * (1 - early), 0.0, 1.0) * known
    found[1:] -= np.clip(parts * late - (ends - 1), 0.0, 1.0) * known
    return found


class Held:
    """A zero-order hold: value k from time k to time k + 1, the last one for ever.

    Args:
      time: [T], s. values: [T, n], finite.
    """

    def __init__(self, time: Floats, values: Floats) -> None:
        self.time, self.values = time, values
        areas = values[:-1] * np.diff(time)[:, None]
        self._area = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(areas, axis=0)])

    def at(self, time: Floats) -> Floats:
        """The values in force at the times [N]: [N, n]; the first one before the first sample."""
        row = np.searchsorted(self.time, time, side="right") - 1
        return np.asarray(self.values[np.maximum(row, 0)])

    def means(self, start: float, step: float, first: int, count: int) -> Floats:
        """Averages [count, n] over the steps `first`, ..., `first + count - 1` from `start` on.

        A step that lies between two samples gets the value itself, bit by bit. In a step that a
        sample falls into, the average gives the actuator the same impulse as the recorded signal.
        """
        borders = np.asarray(start + step * (first + np.arange(count + 1)), np.float64)
        last = len(self.time) - 1
        low = np.searchsorted(self.time, borders[:-1] + SNAP * step, side="right") - 1
        high = np.searchsorted(self.time, borders[1:] - SNAP * step, side="right") - 1
        low, high = np.clip(low, 0, last), np.clip(high, 0, last)
        means = self.values[low]
        mixed = np.flatnonzero(low != high)
        if mixed.size:
            area = self._integral(borders[mixed + 1], high[mixed])
            means[mixed] = (area - self._integral(borders[mixed], low[mixed])) / step
        return means

    def moved(self, shares: Floats) -> Held:
        """With changes that come before the samples that log them, or after.

        Args:
          shares: [T - 1] of the interval before each sample, as of `led`.
        """
        length = np.diff(self.time)
        after = np.append(length[1:], length[-1:])
        earlier = np.where(shares > 0, shares * length, shares * after)
        return Held(np.append(self.time[:1], self.time[1:] - earlier), self.values)

    def within(self, borders: Floats) -> Floats:
        """[N, parts, n]: averages between the borders [N, parts + 1], s, of parts of N intervals
        from the first sample on; the last value stays after the last sample."""
        ends = np.append(self.time, np.maximum(borders.max(), self.time[-1] + 1.0))
        area = np.append(self._area, self._area[-1:] + (ends[-1] - ends[-2]) * self.values[-1:], 0)
        upto = [np.interp(borders, ends, column) for column in area.T]
        whole = np.stack(upto, axis=-1) if upto else np.zeros((*borders.shape, 0))
        return np.asarray(np.diff(whole, axis=1) / np.diff(borders, axis=1)[..., None])

    def _integral(self, time: Floats, row: npt.NDArray[np.int64]) -> Floats:
        since = (time - self.time[row])[:, None]
        return np.asarray(self._area[row] + self.values[row] * since)
