"""When commands change that come at a rate of their own, slower than the log's.

A log says between which samples a command changed. Commands that change at a regular time, which is
no multiple of the sampling interval, say more: only few periods and phases have a change in each of
these intervals and in no other, so that the time of each is known to a small part of an interval.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog

from orbisim.recording.zero_order_hold import led

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class Lead:
    """By how much commands change before the sample that logs them.

    Attributes:
      share: of a sampling interval, 0 to 1: 0.5 for changes anywhere between two samples, which
        come half an interval before on average. With a clock, how much earlier than it ticks
        (negative: later).
      clock: whether commands change by the clock that the log shows; where it shows none, they are
        as they were logged.
    """

    share: float = 0.0
    clock: bool = False

    def __bool__(self) -> bool:
        return self.clock or self.share != 0

    def of(self, time: Floats, values: Floats) -> Floats:
        """[T, n]: means between samples of commands [T, n] that follow one clock
        (`orbisim.recording.zero_order_hold.led`). time: [T], s."""
        if not self.clock:
            return led(values, self.share)
        shares = command_clock(time, values)
        if shares is None:
            return values
        return led(values, np.clip(shares + self.share, 0.0, 1.0)[:, None])


def command_clock(time: Floats, values: Floats) -> Floats | None:
    """[T - 1]: share of each interval that follows a change of commands within it; 0 where nothing
    changes. None where the log shows no clock, or leaves open where in an interval it ticks.

    Args:
      time: [T], s. values: [T, n] commands as logged; NaN is no change.
    """
    rows = np.flatnonzero(np.any(np.diff(values, axis=0) != 0, axis=1) & _known(values))
    length = np.diff(time)
    if len(rows) < _FEWEST or len(rows) > _MOST * len(length):
        return None
    unit = float(np.median(length))
    low, high = time[rows], time[rows + 1]
    for ticks in _numbers(high):
        found = _ticking(ticks, low, high, unit)
        if found is not None:
            shares = np.zeros(len(length))
            shares[rows] = np.clip((high - found) / length[rows], 0.0, 1.0)
            return shares
    return None


def _known(values: Floats) -> npt.NDArray[np.bool_]:
    return np.asarray(np.isfinite(values[1:]).all(axis=1) & np.isfinite(values[:-1]).all(axis=1))


def _numbers(times: Floats) -> list[Ints]:
    """Numbers of the ticks at which changes were logged: one after the other, or with ticks between
    them at which a command stayed."""
    gaps = np.diff(times)
    skipped = np.maximum(np.round(gaps / np.median(gaps)), 1).astype(np.int64)
    every = np.arange(len(times), dtype=np.int64)
    return [every, np.concatenate([[0], np.cumsum(skipped)])]


def _ticking(ticks: Ints, low: Floats, high: Floats, unit: float) -> Floats | None:
    """[N]: times of ticks, in the middle of what intervals leave open; None where no regular clock
    ticks in all of them, or too much is left open."""
    ones, number = np.ones(len(ticks)), ticks - ticks[len(ticks) // 2]
    origin = float(low[len(ticks) // 2])
    late, early = (high - origin) / unit, (low - origin) / unit
    # phase, period and slack: low - slack < phase + number * period <= high + slack
    rows = np.concatenate(
        [np.stack([ones, number, -ones], 1), np.stack([-ones, -number, -ones], 1)]
    )
    limits = np.concatenate([late, -early])
    free: list[tuple[float | None, float | None]] = [(None, None), (0.0, None), (0.0, None)]
    least = linprog([0, 0, 1], A_ub=rows, b_ub=limits, bounds=free)
    if not least.success or least.x[2] > _SLACK:
        return None
    free[2] = (0.0, float(least.x[2]) + 1e-6)
    ends = []
    for place in (number[0], number[-1]):
        cost = np.array([1.0, place, 0.0])
        both = [linprog(sign * cost, A_ub=rows, b_ub=limits, bounds=free) for sign in (1, -1)]
        if not all(one.success for one in both) or both[0].fun + both[1].fun < -_OPEN:
            return None
        ends.append((both[0].fun - both[1].fun) / 2)
    return np.asarray(origin + unit * np.interp(number, [number[0], number[-1]], ends))


_FEWEST = 20
"""Changes that show a clock: fewer fit many."""
_MOST = 0.9
"""Share of the samples; commands that change at every one are as fast as the log, or faster."""
_SLACK = 0.1
"""Of a sampling interval: jitter of stamps."""
_OPEN = 0.3
"""Of a sampling interval: what may be left open, as a mean over an interval leaves half of it."""
