"""What controls were where samples are missing."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.recording import Recording, names
from orbisim.recording.command_clock import command_periods

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Bridged(Recording):
    """A recording with rows for missing samples.

    Attributes:
      unknown: [U] times of those whose controls or torques their neighbours do not tell, s.
    """

    unknown: Floats = dataclasses.field(kw_only=True)

    def __reduce__(self) -> tuple[Any, ...]:
        return (functools.partial(Bridged, unknown=self.unknown), super().__reduce__()[1])


def bridged(recordings: Sequence[Recording], window: float, notes: list[str]) -> list[Recording]:
    """Recordings with a row for each missing sample: no reading there, and controls and torques as
    is likeliest by the samples to either side (`interpolated`). To hold the last one drives a
    machine on that had long been told otherwise, and a step over several intervals is not as exact
    as several. Recordings with commands that follow a clock of their own stay: when they change,
    the log as it is says. So do gaps of more than `LONGEST` samples, as nothing tells what was
    commanded in these.

    Args:
      window: duration, s, over which motion is simulated. Controls are not known where what they
        may be off by does more than `_TOLD` of what all controls of a window do.
      notes: gets a line if anything is missing.
    """
    found, missing, unknown = [], 0, 0
    for one in recordings:
        count = _counted(one.time)
        if (count > 1).any() and not _clocked(one):
            missing += int((count > 1).sum())
            one = _whole(one, count, _TOLD * window / float(np.median(np.diff(one.time))))
            unknown += len(one.unknown)
        found.append(one)
    if missing:
        notes.append(
            f"samples are missing at {missing} places: their controls are the likeliest by those "
            "before and after"
            + (f"; {unknown} whose controls these do not tell are in no window" if unknown else "")
        )
    return found


def _clocked(one: Recording) -> bool:
    """Whether a control or torque follows a clock of its own."""
    held = (v for n, v in one.signals.items() if names.split(n)[0] in names.HELD)
    return any(command_periods(one.time, v.reshape(len(one), -1)) is not None for v in held)


def _counted(time: Floats) -> Ints:
    """[T - 1]: typical sampling intervals that each one lasts: 1 where nothing is missing, or too
    much."""
    if len(time) < 2:
        return np.ones(0, np.int64)
    steps = np.diff(time)
    count = np.round(steps / np.median(steps))
    return np.where((count > 1) & (count <= LONGEST + 1), count, 1).astype(np.int64)


def _whole(one: Recording, count: Ints, most: float) -> Bridged:
    """With rows for missing samples. A sample that is there and has no value (NaN) keeps none.

    Args:
      most: error of a control, over its standard deviation, with which it counts as known.
    """
    rows = np.concatenate([[0], np.cumsum(count)])
    every = np.arange(rows[-1] + 1)
    there, signals = np.isin(every, rows), dict[str, Floats]()
    unknown = np.zeros(len(every), bool)
    for name, values in one.signals.items():
        wide = values.reshape(len(one), -1)
        full = np.full((len(every), wide.shape[1]), np.nan)
        full[rows] = wide
        if names.split(name)[0] in names.HELD:
            for column in full.T:
                column[:], error = interpolated(column, there)
                unknown |= error > most * _spread(column)
        signals[name] = full.reshape(-1, *values.shape[1:])
    time = np.interp(every, rows, one.time)
    kept = {f.name: getattr(one, f.name) for f in dataclasses.fields(Recording)}
    kept |= {"time": time, "signals": signals}
    return Bridged(**kept, unknown=time[unknown])


def _spread(values: Floats) -> float:
    """Standard deviation of what is known of a signal [N]."""
    known = values[np.isfinite(values)]
    return float(known.std()) if len(known) else 0.0


def interpolated(values: Floats, there: Bools) -> tuple[Floats, Floats]:
    """A signal with its missing samples [N], and by how much these may be off [N].

    Each run of missing samples is predicted linearly from `_NEIGHBOURS` samples to either side, by
    the least squares of all places of the signal where so many samples in a row are known (the
    best linear interpolation of a stationary signal; Wiener). Smooth commands are continued
    smoothly, and of those that change at random the mean of all is taken. Where there are fewer
    than `_PLACES` such places, at the ends, and in long gaps: in equal steps from the last known
    sample to the next. What either misses at such places is by how much samples may be off (root
    mean square; infinite where there is no place, and 0 where a sample was logged).

    Args:
      values: [N]; what they are where no sample was logged does not matter.
      there: [N] whether a sample was logged; one that was and is NaN stays so.
    """
    known, error = there & np.isfinite(values), np.where(there, 0.0, np.inf)
    if not known.any():
        return np.full(len(values), np.nan), np.zeros(len(values))
    every = np.arange(len(values))
    found = np.where(there, values, np.interp(every, every[known], values[known]))
    holes = np.flatnonzero(np.diff(np.concatenate([[True], there, [True]]).astype(int)))
    straight = functools.cache(functools.partial(_straight, values, known))
    learned = functools.cache(functools.partial(_learned, values, known))
    for first, stop in zip(holes[::2], holes[1::2], strict=True):
        around = np.r_[first - _NEIGHBOURS : first, stop : stop + _NEIGHBOURS]
        length = int(stop - first)
        if length > LONGEST:
            continue
        error[first:stop] = straight(length)
        inside = around[0] >= 0 and around[-1] < len(values)
        predictor = learned(length) if inside and known[around].all() else None
        if predictor is not None:
            weights, error[first:stop] = predictor
            found[first:stop] = np.append(values[around], 1.0) @ weights
    return found, error


_NEIGHBOURS = 6
"""Samples to either side that predict a missing one: a smooth course of a few shows in so many."""
LONGEST = 12
"""Missing samples in a row that are predicted: as many as those that predict them."""
_PLACES = 120
"""Places by which a prediction is learned: ten for each of its numbers."""


def _learned(values: Floats, known: Bools, length: int) -> tuple[Floats, Floats] | None:
    """[2 neighbours + 1, length]: weights of the samples around missing ones, and of one; and what
    they miss [length]."""
    rows = _places(values, known, 2 * _NEIGHBOURS + length)
    if len(rows) < _PLACES:
        return None
    inside = rows[:, _NEIGHBOURS : _NEIGHBOURS + length]
    around = np.concatenate([rows[:, :_NEIGHBOURS], rows[:, -_NEIGHBOURS:]], axis=1)
    design = np.append(around, np.ones((len(rows), 1)), axis=1)
    weights = np.linalg.lstsq(design, inside, rcond=_CLOSE)[0]
    return weights, _root_mean_square(design @ weights - inside)


def _straight(values: Floats, known: Bools, length: int) -> Floats:
    """[length]: what equal steps between known samples miss of those in between."""
    rows = _places(values, known, length + 2)
    if not len(rows):
        return np.full(length, np.inf)
    share = np.arange(1, length + 1) / (length + 1)
    line = rows[:, :1] + share * (rows[:, -1:] - rows[:, :1])
    return _root_mean_square(line - rows[:, 1:-1])


def _places(values: Floats, known: Bools, span: int) -> Floats:
    """[N, span]: so many samples in a row, wherever all are known."""
    if len(values) < span:
        return np.zeros((0, span))
    first = np.flatnonzero(np.lib.stride_tricks.sliding_window_view(known, span).all(axis=1))
    return np.asarray(values[first[:, None] + np.arange(span)])


def _root_mean_square(values: Floats) -> Floats:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


_CLOSE = 1e-9
"""Of the largest singular value, those that count as none: commands that are smooth to rounding."""
_TOLD = 1e-3
"""Part of what all controls of a window do, as one of them does by which it may be off: motion is
rarely known better than to a thousandth."""
