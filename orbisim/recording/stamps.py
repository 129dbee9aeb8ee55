"""Time stamps that a host wrote when samples arrived, not when they were taken.

A controller samples on a regular grid; a bus and a scheduler deliver late by a part of the sampling
interval that changes from sample to sample. A joint that moves then seems to jump by its speed
times that. Whether stamps are such, or a true record of irregular sampling, the stamps cannot tell;
the signals can: on the right times they are smoother.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.optimize import isotonic_regression

from orbisim.recording.noise import noise_std
from orbisim.recording.recording import Recording

Floats = npt.NDArray[np.float64]


def regular(
    recordings: Sequence[Recording], others: Sequence[Recording] = ()
) -> tuple[list[Recording], list[Recording]]:
    """Recordings of one machine on the grids about which their stamps scatter, if most scatter
    about one and measured positions are surely smoother there, in all of them together; else as
    they are. A note says what was done.

    Args:
      recordings: any; positions are `qpos`, `xpos` and `sensor` signals.
      others: of the same machine, which have no say.

    Returns:
      Both, in their order.
    """
    scattered = [one for one in recordings if grid_of(one.time) is not None]
    drops = np.concatenate([*map(_drop, scattered), np.zeros(0)])
    if 2 * len(scattered) <= len(recordings) or not len(drops) or drops.mean() <= _SMOOTHER:
        return list(recordings), list(others)
    smoother = float(np.exp(drops.mean()))
    found, also = ([_on_grid(one, smoother) for one in part] for part in (recordings, others))
    return found, also


def _on_grid(recording: Recording, smoother: float) -> Recording:
    grid = grid_of(recording.time)
    if grid is None:
        return recording
    told = (
        f"time stamps scatter by {1e3 * float(np.std(recording.time - grid)):.2g} ms about samples "
        f"every {1e3 * float(np.median(np.diff(grid))):.4g} ms, and positions of all recordings "
        f"are {smoother:.2g} times smoother there: that grid was taken"
    )
    return recording.replace(time=grid, notes=(*recording.notes, told))


def _drop(recording: Recording) -> Floats:
    """By how much the logarithm of each signal's noise is lower on the grid, where it is known with
    both; nothing without a grid."""
    grid = grid_of(recording.time)
    signals = [v for n, v in recording.signals.items() if n.split("/")[0] in _CONTINUOUS]
    if grid is None or not signals:
        return np.zeros(0)
    logged, better = (
        np.concatenate([np.ravel(noise_std(time, v)) for v in signals])
        for time in (recording.time, grid)
    )
    known = np.isfinite(logged) & np.isfinite(better) & (np.minimum(logged, better) > 0)
    return np.asarray(np.log(logged[known] / better[known]))


def grid_of(time: Floats) -> Floats | None:
    """Whole multiples of a sampling interval about which stamps scatter, with gaps where samples
    are missing; None if they lie on one already, or scatter about none.

    The interval is that at which the stamps' phases agree most (the periodogram of the stamps);
    each stamp then gets the number of its sample, numbers increasing, by isotonic regression, so
    that a stamp that is late by more than half an interval does not move those after it.

    Args:
      time: [T], s, increasing.
    """
    count = len(time)
    if count < _FEWEST:
        return None
    guess = float(np.median(np.diff(time)))
    step, agreement = regular_interval(time, guess)
    if not agreement > max(_AGREE, 5 / np.sqrt(count)):
        return None
    phase = float(np.angle(np.exp(2j * np.pi * time / step).mean())) * step / (2 * np.pi)
    order = np.arange(count)
    missing = np.round(isotonic_regression((time - phase) / step - order).x)
    if missing[-1] == missing[-2] + 1:  # no later stamp says so, and late is more usual
        missing[-1] = missing[-2]
    number = order + missing
    slope, offset = np.polyfit(number, time, 1)
    grid = offset + slope * number
    apart = float(np.std(time - grid))
    if not _ALREADY * step < apart < step / 2:
        return None
    return np.asarray(grid, np.float64)


def regular_interval(time: Floats, guess: float) -> tuple[float, float]:
    """The sampling interval close to a guess at which phases agree most, and how much: the length
    of their mean, 0 to 1. Phases of few samples agree over a wide range of intervals, those of
    many over a narrow one: looked for with the first samples, then with twice as many, and so on.
    """
    count, step, reach = min(_FIRST, len(time)), guess, _REACH
    while True:
        part = time[:count] - time[0]
        width = guess / (4 * float(part[-1]))  # a quarter of the peak's
        steps = step * (1 + np.arange(-reach, reach + width, width))
        found = [abs(np.exp(2j * np.pi * part / one).mean()) for one in steps]
        step, agreement = float(steps[int(np.argmax(found))]), float(max(found))
        if count == len(time):
            return step, agreement
        count, reach = min(2 * count, len(time)), 4 * width


_CONTINUOUS = ("qpos", "xpos", "sensor")
"""Signals that are sampled, and are smooth where a body moves on its own."""
_SMOOTHER = 0.1
"""Logarithm of the ratio of the noises: chance moves an estimate of 300 samples by 0.04."""
_FEWEST = 30
"""Samples from which a grid can be told."""
_AGREE = 0.15
"""Of phases: stamps that scatter by 0.31 of an interval still agree by as much."""
_ALREADY = 1e-4
"""Of an interval: stamps that are rounded to microseconds at 100 Hz lie on their grid."""
_REACH = 0.05
"""By which the median of the differences may be off the interval: late stamps come in pairs of a
long and a short one, and their median hardly moves."""
_FIRST = 256
"""Samples with which an interval is looked for first: chance agrees by 0.06."""
