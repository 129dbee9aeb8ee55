"""Signals that were sampled by different clocks, at common times."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from orbisim.errors import RecordingError
from orbisim.recording import names
from orbisim.recording.contents import Contents
from orbisim.recording.sampling import resampled

Floats = npt.NDArray[np.float64]

_LEADERS = ("qpos", "xpos", "qvel", "sensor", "sensordata", "torque", "ctrl")
"""Kinds of signals in the order in which their clock is taken: windows start where positions are
known."""
_GAP = 5.0
"""Times the median interval from which on there is a gap: across it nothing is interpolated."""


def main_part(parts: Sequence[Contents]) -> int:
    """Number of the part whose times are taken: that with the most signals of the first kind."""
    for kind in _LEADERS:
        counts = [sum(names.split(name)[0] == kind for name in part.signals) for part in parts]
        if any(counts):
            return int(np.argmax(counts))
    return 0


def merged(parts: Sequence[Contents], main: int) -> Contents:
    """All signals at the times of the main part.

    Controls and torques are the values in force, orientations are interpolated along the arc, all
    others linearly. Before the first and after the last sample of a signal, and in its gaps, it is
    missing (NaN); a control is in force until the next one, and after the last.

    Raises:
      RecordingError: two parts have the same signal, or one does not overlap with the main part.
    """
    if len(parts) == 1:
        return parts[0]
    target = parts[main]
    time = target.time
    signals, units, notes = dict(target.signals), dict(target.units), list(target.notes)
    for part in (one for index, one in enumerate(parts) if index != main):
        twice = signals.keys() & part.signals.keys()
        if twice:
            problem = "is sampled by two clocks; choose one in a map"
            raise RecordingError(target.source, problem, element=repr(min(twice)))
        for each in (time, part.time):
            _check_time(each, target.source)
        for name, values in part.signals.items():
            signals[name] = _at(part, name, np.asarray(values, np.float64), time)
        units |= part.units
        notes += [*part.notes, _note(part, target)]
    notes = list(dict.fromkeys(notes))
    return dataclasses.replace(target, signals=signals, units=units, notes=tuple(notes))


def _check_time(time: Floats, source: str) -> None:
    """Raises `RecordingError` unless the times can be interpolated between."""
    if time.ndim != 1 or not len(time) or not np.isfinite(time).all() or (np.diff(time) <= 0).any():
        raise RecordingError(
            source,
            "must be finite and strictly increase to be brought to common times",
            element="'time'",
            remedy="sort the rows and remove repeated ones",
        )


def _at(part: Contents, name: str, values: Floats, time: Floats) -> Floats:
    """A signal at other times, NaN where it is not known."""
    before = part.time
    if name == "qpos":
        raise RecordingError(
            part.source,
            "may hold quaternions and cannot be brought to other times",
            element="'qpos'",
            remedy="let it be the clock of the map",
        )
    if len(values) != len(before) or values.ndim > 2:
        raise RecordingError(
            part.source,
            f"needs a row for each of the {len(before)} times; got shape {values.shape}",
            element=repr(name),
        )
    held = names.split(name)[0] in names.HELD
    inside = (time >= before[0]) & (held | (time <= before[-1]))
    if len(before) > 2 and not held:
        row = np.clip(np.searchsorted(before, time, side="right") - 1, 0, len(before) - 2)
        gaps = np.diff(before)
        wide = gaps[row] > _GAP * np.median(gaps)
        inside &= ~wide | (time == before[row]) | (time == before[row + 1])
    if not inside.any():
        raise RecordingError(
            part.source,
            f"its times, {before[0]:.6g} to {before[-1]:.6g} s, do not meet those of the other "
            f"signals, {time[0]:.6g} to {time[-1]:.6g} s",
            element=repr(name),
            remedy="leave it out of the map, or make its clock that of the others",
        )
    found = np.full((len(time), *values.shape[1:]), np.nan)
    found[inside] = resampled(before, name, values, time[inside])
    return found


def _note(part: Contents, target: Contents) -> str:
    some = ", ".join(repr(name) for name in list(part.signals)[:4])
    more = ", ..." if len(part.signals) > 4 else ""
    return (
        f"{some}{more} were sampled at {_rate(part)}, and are resampled at the times of the other "
        f"signals ({_rate(target)})"
    )


def _rate(part: Contents) -> str:
    if len(part.time) < 2:
        return f"{len(part.time)} times"
    return f"{1.0 / float(np.median(np.diff(part.time))):.4g} Hz"
