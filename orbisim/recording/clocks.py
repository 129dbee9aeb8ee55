"""Times of a log's columns, in seconds."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from orbisim.errors import RecordingError
from orbisim.recording import units
from orbisim.recording.formats import labels
from orbisim.recording.formats.log import Array, Column, Log
from orbisim.recording.units import Unit

Floats = npt.NDArray[np.float64]

NAME = "time"
_FAR = 1e8
"""Seconds from which on times count from the first one: no recording takes three years, but clocks
count from 1970, and a double then has steps of a quarter of a microsecond."""
_SLOW = 0.5
"""Seconds between samples from which on a log of a robot looks like one in milliseconds."""
_TICKS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


@dataclasses.dataclass(frozen=True)
class Clock:
    """The time of a group of columns.

    Attributes:
      column: the column that holds it, None if the format itself gives it.
      unit: of the column.
      note: what is to be said of it.
    """

    column: Column | None
    unit: Unit
    note: str | None = None


def clock_of(log: Log, group: str) -> Clock:
    """The clock of a group: what is called time in it, or in the nearest group above.

    Raises:
      RecordingError: there is none, or several.
    """
    if group in log.clocks:
        return Clock(None, units.parse("s"))
    while True:
        found = _called_time(log, group)
        if found is not None or not group:
            break
        group = group.rpartition("/")[0]
    if found is None:
        raise RecordingError(
            log.source,
            f"has no 'time'; it has {listed(log)}",
            remedy="name the time of each sample 'time', with its unit if that is not s "
            "('time [ms]'), or say in a map which column it is (orbisim recording init)",
        )
    return found


def _called_time(log: Log, group: str) -> Clock | None:
    """The one column of a group that is called time."""
    here = [column for column in log.columns if column.group == group]
    exact = [column for column in here if column.name.rpartition("/")[2] == NAME]
    if exact or log.literal:
        return _with_unit(exact[0], exact[0].unit or "s") if exact else None
    named = [(c, labels.parse(c.name)) for c in here]
    named = [(c, label) for c, label in named if labels.is_time(label.name)]
    if len(named) > 1:
        both = " and ".join(repr(column.name) for column, _ in named[:2])
        raise RecordingError(
            log.source,
            f"{both} both look like the time",
            remedy="say in a map which one it is (orbisim recording init)",
        )
    for column, label in named:
        unit = column.unit or label.unit
        clock = _with_unit(column, unit or "s")
        if clock is not None and unit is None and label.name != NAME:
            note = f"{column.name!r} is taken as the time in seconds, as it names no unit"
            return dataclasses.replace(clock, note=note)
        return clock
    return None


def _with_unit(column: Column, text: str) -> Clock | None:
    try:
        unit = units.parse(text)
    except ValueError:
        return None
    return Clock(column, unit) if unit.si in ("s", units.AS_IT_IS) else None


def seconds(values: Array, unit: Unit, source: str, name: str = NAME) -> tuple[Floats, str | None]:
    """Times in seconds, and a note if they count from the first sample.

    Whole numbers (nanoseconds since 1970, say) are subtracted before they are rounded.

    Args:
      values: [T] numbers, or `datetime64` or `timedelta64`. unit: of numbers.

    Raises:
      RecordingError: they are no numbers.
    """
    if values.dtype.kind in "mM":
        per_second = _TICKS[np.datetime_data(values.dtype)[0]]
        values, unit = values.astype(np.int64), Unit("ticks", "s", 1.0 / per_second)
    if values.dtype.kind not in "fiub":
        raise RecordingError(source, f"must hold numbers; got {values.dtype}", element=repr(name))
    if values.ndim != 1 or not len(values):
        return values, None  # which is refused as a recording's time
    first = values[0]
    if unit.factor == 1.0 and values.dtype.kind == "f":
        return values, None
    if np.isfinite(first) and abs(float(first) * unit.factor) > _FAR:
        start = float(first) * unit.factor
        note = f"time counts from the first sample, {start:.6f} s in {name!r}"
        shifted = values - first if values.dtype.kind == "f" else _differences(values)
        return units.converted(np.asarray(shifted, np.float64), unit), note
    return units.converted(np.asarray(values, np.float64), unit), None


def _differences(values: Array) -> Floats:
    """Whole numbers from the first one on, exact within 64 bits."""
    wide = values.astype(np.uint64) if values.dtype.kind == "u" else values.astype(np.int64)
    after = wide >= wide[0]
    up = (wide - wide[0]).astype(np.float64)
    down = (wide[0] - wide).astype(np.float64)
    return np.where(after, up, -down)


def slow(time: Floats) -> str | None:
    """What to say of samples that are so far apart that their times may not be in seconds."""
    step = float(np.median(np.diff(time))) if time.ndim == 1 and len(time) > 2 else 0.0
    if not step >= _SLOW:
        return None
    unit = "ms" if step < 1e3 * _SLOW else "us" if step < 1e6 * _SLOW else "ns"
    return f"samples are {step:.4g} s apart: if these are {unit}, name the column 'time [{unit}]'"


def listed(log: Log, most: int = 30) -> str:
    """The columns of a log, for messages."""
    if not log.columns:
        return "no columns"
    shown = ", ".join(repr(name) for name in log.names[:most])
    more = f" and {len(log.names) - most} more" if len(log.names) > most else ""
    return f"the columns {shown}{more}"
