"""What controls were where samples are missing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from orbisim.recording import Recording, names
from orbisim.recording.blocks import LONGEST_GAP
from orbisim.recording.command_clock import command_period
from orbisim.recording.thinning import thinned_of

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]


def bridged(recordings: Sequence[Recording], notes: list[str]) -> list[Recording]:
    """Recordings whose controls and torques go on where samples are missing: to hold the last one
    drives a machine on that had long been told otherwise. What they were there is the likeliest by
    the samples to either side (`interpolated`); the recording has their means, and `Thinned.whole`
    each of them. Those that follow a clock of their own stay: when they change, the log as it is
    says. So do all in gaps over which no motion is estimated (`LONGEST_GAP`), as nothing is
    simulated there.

    Args:
      notes: gets a line if anything is missing.
    """
    found, missing = [], 0
    for one in recordings:
        count = _counted(one.time)
        through = one if (count == 1).all() else thinned_of(one, _whole(one, count))
        if not all(_same(values, through.signals[n]) for n, values in one.signals.items()):
            missing += int((count > 1).sum())
            one = through
        found.append(one)
    if missing:
        notes.append(
            f"samples are missing at {missing} places: the controls there are the likeliest by "
            "those before and after"
        )
    return found


def _same(one: Floats, other: Floats) -> bool:
    """Whether signals are the same to rounding."""
    return np.allclose(one, other, rtol=1e-9, atol=1e-12, equal_nan=True)


def _counted(time: Floats) -> Ints:
    """[T - 1]: typical sampling intervals that each one lasts: 1 where nothing is missing, or too
    much."""
    if len(time) < 2:
        return np.ones(0, np.int64)
    steps = np.diff(time)
    count = np.round(steps / np.median(steps))
    return np.where((count > 1) & (count <= LONGEST_GAP), count, 1).astype(np.int64)


def _whole(one: Recording, count: Ints) -> Recording:
    """All held signals at the samples that there are and at those that are missing. A sample that
    is there and has no value (NaN) keeps none."""
    rows = np.concatenate([[0], np.cumsum(count)])
    every = np.arange(rows[-1] + 1)
    there, signals = np.isin(every, rows), dict[str, Floats]()
    for name, values in one.signals.items():
        if names.split(name)[0] not in names.HELD:
            continue
        wide = values.reshape(len(one), -1)
        full = wide[np.searchsorted(rows, every, side="right") - 1]
        if command_period(one.time, wide) is None:
            full = np.stack([interpolated(column, there) for column in full.T], axis=1)
        signals[name] = full.reshape(-1, *values.shape[1:])
    return Recording(np.interp(every, rows, one.time), signals, source=one.source)


def interpolated(values: Floats, there: Bools) -> Floats:
    """[N]: a signal with its missing samples.

    Each run of missing samples is predicted linearly from `_NEIGHBOURS` samples to either side, by
    the least squares of all places of the signal where so many samples in a row are known (the
    best linear interpolation of a stationary signal; Wiener). Smooth commands are continued
    smoothly, and of those that change at random the mean of all is taken. Where there are fewer
    than `_PLACES` such places, at the ends, and in long gaps: in equal steps from the last known
    sample to the next.

    Args:
      values: [N]; what they are where no sample was logged does not matter.
      there: [N] whether a sample was logged; one that was and is NaN stays so.
    """
    known = there & np.isfinite(values)
    if not known.any():
        return np.full(len(values), np.nan)
    every = np.arange(len(values))
    found = np.where(there, values, np.interp(every, every[known], values[known]))
    holes = np.flatnonzero(np.diff(np.concatenate([[True], there, [True]]).astype(int)))
    learned: dict[int, Floats | None] = {}
    for first, stop in zip(holes[::2], holes[1::2], strict=True):
        around = np.r_[first - _NEIGHBOURS : first, stop : stop + _NEIGHBOURS]
        length = int(stop - first)
        if length > _LONGEST or around[0] < 0 or around[-1] >= len(values):
            continue
        if length not in learned:
            learned[length] = _predictor(values, known, length)
        weights = learned[length]
        if weights is not None and known[around].all():
            found[first:stop] = np.append(values[around], 1.0) @ weights
    return found


_NEIGHBOURS = 6
"""Samples to either side that predict a missing one: a smooth course of a few shows in so many."""
_LONGEST = 12
"""Missing samples in a row that are predicted: as many as those that predict them."""
_PLACES = 120
"""Places by which a prediction is learned: ten for each of its numbers."""


def _predictor(values: Floats, known: Bools, length: int) -> Floats | None:
    """[2 neighbours + 1, length]: weights of the samples around missing ones, and of one."""
    span = 2 * _NEIGHBOURS + length
    if len(values) < span:
        return None
    places = np.flatnonzero(np.lib.stride_tricks.sliding_window_view(known, span).all(axis=1))
    if len(places) < _PLACES:
        return None
    rows = values[places[:, None] + np.arange(span)]
    around = np.concatenate([rows[:, :_NEIGHBOURS], rows[:, -_NEIGHBOURS:]], axis=1)
    design = np.append(around, np.ones((len(rows), 1)), axis=1)
    return np.asarray(
        np.linalg.lstsq(design, rows[:, _NEIGHBOURS : _NEIGHBOURS + length], rcond=_CLOSE)[0]
    )


_CLOSE = 1e-9
"""Of the largest singular value, those that count as none: commands that are smooth to rounding."""
