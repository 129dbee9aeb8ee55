"""What controls were where samples are missing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from orbisim.recording import Recording, names
from orbisim.recording.command_clock import command_period
from orbisim.recording.thinning import thinned_of
from orbisim.recording.zero_order_hold import Held

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]


def bridged(recordings: Sequence[Recording], notes: list[str]) -> list[Recording]:
    """Recordings whose controls and torques go on where samples are missing: to hold the last one
    drives a machine on that had long been told otherwise. What they were there is the likeliest by
    the samples to either side (`interpolated`); the recording has their means, and `Thinned.whole`
    each of them. Those that follow a clock of their own stay: when they change, the log as it is
    says.

    Args:
      notes: gets a line if anything is missing.
    """
    found, missing = [], 0
    for one in recordings:
        count = _counted(one.time)
        held = [n for n in one.signals if names.split(n)[0] in names.HELD]
        wide = {n: np.asarray(one.signals[n], np.float64).reshape(len(one), -1) for n in held}
        held = [n for n in held if command_period(one.time, wide[n]) is None]
        if (count > 1).any() and held:
            whole = _whole(one, count, {n: wide[n] for n in held})
            means = {n: _means(one.time, whole, n).reshape(one.signals[n].shape) for n in held}
            if any(not _same(one.signals[n], v) for n, v in means.items()):
                missing += int((count > 1).sum())
                one = thinned_of(one.replace(signals={**one.signals, **means}), whole)
        found.append(one)
    if missing:
        notes.append(
            f"samples are missing at {missing} places: the controls there are the likeliest by "
            "those before and after"
        )
    return found


def _same(one: Floats, other: Floats) -> bool:
    """Whether controls are the same to rounding."""
    return np.allclose(one, other, rtol=1e-9, atol=1e-12, equal_nan=True)


def _counted(time: Floats) -> Ints:
    """[T - 1]: typical sampling intervals that each one lasts: 1 where nothing is missing."""
    if len(time) < 2:
        return np.ones(0, np.int64)
    steps = np.diff(time)
    return np.maximum(np.round(steps / np.median(steps)), 1).astype(np.int64)


def _whole(one: Recording, count: Ints, held: dict[str, Floats]) -> Recording:
    """All held signals at the samples that there are and at those that are missing. A sample that
    is there and has no value (NaN) keeps none."""
    rows = np.concatenate([[0], np.cumsum(count)])
    every = np.arange(rows[-1] + 1)
    there = np.isin(every, rows)
    signals = {n: one.signals[n][np.searchsorted(rows, every, side="right") - 1] for n in
               one.signals if names.split(n)[0] in names.HELD}  # fmt: skip
    for name, values in held.items():
        full = np.full((len(every), values.shape[1]), np.nan)
        full[rows] = values
        for column in full.T:
            column[:] = interpolated(column, there)
        signals[name] = full.reshape(-1, *one.signals[name].shape[1:])
    return Recording(np.interp(every, rows, one.time), signals, source=one.source)


def _means(time: Floats, whole: Recording, name: str) -> Floats:
    """[T, n]: means of a held signal from each sample to the next; NaN beside a missing value."""
    values = whole.signals[name].reshape(len(whole), -1)
    borders = np.stack([time[:-1], time[1:]], axis=1)
    means = Held(whole.time, np.nan_to_num(values)).within(borders)[:, 0]
    rows = np.searchsorted(whole.time, time)
    unknown = np.logical_or.reduceat(np.isnan(values), rows, axis=0)
    simple = np.append(np.diff(rows) == 1, True)
    found = np.where(simple[:, None], values[rows], np.append(means, values[-1:], axis=0))
    return np.where(unknown & ~simple[:, None], values[rows], found)


def interpolated(values: Floats, there: Bools) -> Floats:
    """[N]: a signal with its missing samples.

    Each run of missing samples is predicted linearly from `_NEIGHBOURS` samples to either side, by
    the least squares of all places of the signal where so many samples in a row are known (the
    best linear interpolation of a stationary signal; Wiener). Smooth commands are continued
    smoothly, and of those that change at random the mean of all is taken. Where there are fewer
    than `_PLACES` such places, at the ends, and in long gaps: in equal steps from the last known
    sample to the next.

    Args:
      values: [N]. there: [N] whether a sample was logged; one that was and is NaN stays so.
    """
    known = there & np.isfinite(values)
    if known.sum() < 2:
        return values
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
