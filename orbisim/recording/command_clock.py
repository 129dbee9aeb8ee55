"""When commands change that come at a rate of their own, slower than the log's.

A log says between which samples a command changed. Commands that change at a regular time, which is
no multiple of the sampling interval, say more: only few periods and phases have a change in each of
these intervals and in no other, so that the time of each is known to a small part of an interval.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from orbisim.recording.stamps import regular_interval

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Periods = tuple[float, float]
"""Shortest and longest, s."""


@dataclasses.dataclass(frozen=True)
class Lead:
    """By how much commands change before the sample that logs them.

    Attributes:
      share: of a sampling interval, -1 to 1: 0.5 for changes anywhere between two samples, which
        come half an interval before on average; negative where commands arrive late. With a clock,
        how much earlier than it ticks.
      clock: whether commands change by the clock that the log shows; where it shows none, they are
        as they were logged.
      period: of that clock, s, where other logs of the machine show it; 0 if each shows its own.
    """

    share: float = 0.0
    clock: bool = False
    period: float = 0.0

    def __bool__(self) -> bool:
        return self.clock or self.share != 0

    def shares(self, time: Floats, values: Floats) -> Floats:
        """[T - 1]: by what share of each interval between samples commands [T, n] that follow one
        clock change before the sample that logs them. time: [T], s."""
        if not self.clock:
            return np.full(max(len(time) - 1, 0), self.share)
        found = command_clock(time, values, self.period)
        return np.zeros(len(time) - 1) if found is None else np.clip(found + self.share, 0.0, 1.0)


def command_clock(time: Floats, values: Floats, period: float = 0.0) -> Floats | None:
    """[T - 1]: share of each interval that follows a change of commands within it; 0 where nothing
    changes. None where the log shows no clock, or leaves open where in an interval it ticks.

    Args:
      time: [T], s. values: [T, n] commands as logged; NaN is no change.
      period: of the clock, s, where it is known.
    """
    found = _clock(time, values, period)
    if found is None:
        return None
    rows, ticks, _ = found
    length = np.diff(time)
    shares = np.zeros(len(length))
    shares[rows] = np.clip((time[rows + 1] - ticks) / length[rows], 0.0, 1.0)
    return shares


def command_periods(time: Floats, values: Floats) -> Periods | None:
    """Shortest and longest period that the clock may have by which commands change, s; None where
    the log shows none.

    Args:
      time: [T], s. values: [T, n] commands as logged.
    """
    found = _clock(time, values, 0.0)
    return None if found is None else found[2]


def common_period(known: Periods, others: Sequence[Periods]) -> float:
    """In the middle of what one log leaves open of the period of a clock, s, and those of other
    logs that leave a part of it open, too: what one log leaves, another may rule out."""
    low, high = known
    for one in others:
        if max(low, one[0]) <= min(high, one[1]):
            low, high = max(low, one[0]), min(high, one[1])
    return (low + high) / 2


def _clock(time: Floats, values: Floats, period: float) -> tuple[Ints, Floats, Periods] | None:
    """Intervals in which commands change, [N], the times at which they do, and the shortest and
    longest period that these have."""
    rows = np.flatnonzero(np.any(np.diff(values, axis=0) != 0, axis=1) & _known(values))
    if len(rows) < _FEWEST or len(rows) > _MOST * (len(time) - 1):
        return None
    unit = float(np.median(np.diff(time)))
    low, high = time[rows], time[rows + 1]
    for numbers in _numbers(high, period):
        found = _ticking(numbers, low, high, unit, period)
        if found is not None:
            return rows, *found
    return None


def _known(values: Floats) -> npt.NDArray[np.bool_]:
    return np.asarray(np.isfinite(values[1:]).all(axis=1) & np.isfinite(values[:-1]).all(axis=1))


def _numbers(times: Floats, period: float) -> list[Ints]:
    """Numbers of the ticks at which changes were logged, by a known period; or one after the other,
    or with ticks between them at which a command stayed: as many as the shortest gaps say, or as
    the period does at which all changes have the most alike phases (a long stay says little of how
    many ticks it had)."""
    gaps = np.diff(times)
    if period > 0:
        return [_counted(gaps, period)]
    every = np.arange(len(times), dtype=np.int64)
    usual = float(np.median(gaps))
    guess = float(gaps[gaps < 1.5 * usual].mean())  # single ticks, mostly
    return [every, _counted(gaps, usual), _counted(gaps, regular_interval(times, guess)[0])]


def _counted(gaps: Floats, period: float) -> Ints:
    skipped = np.maximum(np.round(gaps / period), 1).astype(np.int64)
    return np.concatenate([[0], np.cumsum(skipped)])


def _ticking(
    ticks: Ints, low: Floats, high: Floats, unit: float, period: float
) -> tuple[Floats, Periods] | None:
    """[N]: times of ticks, in the middle of what intervals leave open, and what these leave open of
    the period; None where no regular clock ticks in all of them, or too much is left open."""
    number, origin = ticks - ticks[len(ticks) // 2], float(low[len(ticks) // 2])
    late, early = (high - origin) / unit, (low - origin) / unit
    # phase, period and slack: low - slack < phase + number * period <= high + slack
    rows, limits = np.empty((0, 3)), np.empty(0)
    for sign, values in ((1, late), (-1, -early)):
        some = _outermost(number, values)
        one = np.stack([np.full(len(some), sign), sign * number[some], np.full(len(some), -1)], 1)
        rows, limits = np.concatenate([rows, one]), np.concatenate([limits, values[some]])
    free: list[tuple[float | None, float | None]] = [(None, None), (0.0, None), (0.0, None)]
    if period > 0:
        free[1] = ((1 - _KNOWN) * period / unit, (1 + _KNOWN) * period / unit)
    least = linprog([0, 0, 1], A_ub=rows, b_ub=limits, bounds=free)
    if not least.success or least.x[2] > _SLACK:
        return None
    free[2] = (0.0, float(least.x[2]) + 1e-6)
    found = []
    for cost in ([1.0, number[0], 0.0], [1.0, number[-1], 0.0], [0.0, 1.0, 0.0]):
        both = [
            linprog(sign * np.array(cost), A_ub=rows, b_ub=limits, bounds=free) for sign in (1, -1)
        ]
        if not all(one.success for one in both):
            return None
        found.append((both[0].fun, -both[1].fun))
    *ends, periods = found
    if any(most - least > _OPEN for least, most in ends):
        return None
    times = np.interp(number, [number[0], number[-1]], [(least + most) / 2 for least, most in ends])
    return origin + unit * times, (unit * periods[0], unit * periods[1])


def _outermost(number: Ints, values: Floats) -> Ints:
    """Points whose convex hull all of them lie in: a line that passes these passes all."""
    level = values - np.polyval(np.polyfit(number, values, 1), number)
    points = np.stack([number / np.ptp(number), level], axis=1)
    return np.asarray(ConvexHull(points, qhull_options="QJ").vertices)  # may lie in a line


_FEWEST = 20
"""Changes that show a clock: fewer fit many."""
_MOST = 0.9
"""Share of the samples; commands that change at every one are as fast as the log, or faster."""
_SLACK = 0.1
"""Of a sampling interval: jitter of stamps."""
_KNOWN = 5e-4
"""By which a period is off that another log shows: its changes tell it to a few ten thousandths.
Six times as much leaves a clock open that is nearly a multiple of the interval."""
_OPEN = 0.3
"""Of a sampling interval: what may be left open, as a mean over an interval leaves half of it."""
