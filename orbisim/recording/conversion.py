"""From a log to the contents of a recording: names, units, one time."""

from __future__ import annotations

import collections
import dataclasses
import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from orbisim.errors import RecordingError, UnknownNameError
from orbisim.recording import clocks, merging, names, units
from orbisim.recording.contents import Contents
from orbisim.recording.formats import labels
from orbisim.recording.formats.log import Array, Column, Log
from orbisim.recording.mapping import TIME, Entry, SignalMap
from orbisim.recording.units import Unit

Floats = npt.NDArray[np.float64]

_COMPONENT = re.compile(r"(?s)(.+)\[(\d{1,6})\]")
_LONGEST, _MOST_COMPARED = 200, 1000
"""Characters of a name, and columns, that are compared with a name that is not found."""
_MOST_NOTES = 8
"""Ignored columns that are named in a note each; more are named in one."""


@dataclasses.dataclass(frozen=True)
class Pick:
    """A column that is wanted.

    Attributes:
      column: which. component: of an array [T, n]; None: all of it.
      signal: what it becomes: a signal, a component of one, or time.
      unit: to convert from; None if it is taken as it is.
      entry: what a map says of it, None without one.
    """

    column: Column
    signal: str
    unit: Unit | None
    component: int | None = None
    entry: Entry | None = None


def contents_of(log: Log, mapping: SignalMap | None = None) -> Contents:
    """The signals of a log in SI units, at common times.

    Without a map, columns that bear the name of a signal are taken, and those of which the format
    itself says what they are.

    Raises:
      RecordingError: there is no time, a unit is not known, two columns are the same signal, or the
        map names a column that the log has not.
    """
    _check_once(log)
    picks = _named(log) if mapping is None else _mapped(log, mapping)
    times = [pick for pick in picks if pick.signal == TIME]
    signals = [pick for pick in picks if pick.signal != TIME]
    _check_apart(log, picks)
    chosen = times[0] if times else None
    groups = list(dict.fromkeys(pick.column.group for pick in signals))
    groups = groups or [_any_group(log) if chosen is None else chosen.column.group]
    parts, used = [], set[str]()
    for group in groups:
        mine = [pick for pick in signals if pick.column.group == group]
        parts.append(_part(log, group, mine, chosen, used))
    ignored = [name for name in log.names if name not in used]
    notes = log.notes + (() if mapping else tuple(_ignored_notes(ignored)))
    main = _main_group(log, mapping, groups)
    whole = merging.merged(parts, main if main is not None else merging.main_part(parts))
    return dataclasses.replace(
        whole,
        units={**log.header.get("units", {}), **whole.units},
        metadata=log.header.get("metadata", {}),
        notes=(*notes, *whole.notes),
        columns=tuple(ignored),
        map_file=None if mapping is None else mapping.source,
    )


# -- which columns -----------------------------------------------------------------------------


def _check_once(log: Log) -> None:
    repeated = [name for name, n in collections.Counter(log.names).items() if n > 1]
    if repeated:
        raise RecordingError(log.source, "stands in two columns", element=repr(repeated[0]))


def _named(log: Log) -> list[Pick]:
    """Columns that say themselves which signal they are."""
    found = []
    for column in log.columns:
        label = labels.Label(column.name, None) if log.literal else labels.parse(column.name)
        signal = column.signal or label.name
        plain = names.is_component if log.table else names.is_signal
        if column.signal or plain(signal):
            stated = column.unit if column.unit is not None else label.unit
            found.append(Pick(column, signal, _unit(log, column, stated)))
    return found


def _mapped(log: Log, mapping: SignalMap) -> list[Pick]:
    """The columns of a map."""
    return [_found(log, mapping, entry) for entry in mapping.entries]


def _found(log: Log, mapping: SignalMap, entry: Entry) -> Pick:
    columns = {column.name.strip(): column for column in log.columns}
    name, component = entry.column.strip(), None
    indexed = _COMPONENT.fullmatch(name)
    if name not in columns and indexed and indexed[1] in columns:
        name, component = indexed[1], int(indexed[2])
    if name not in columns:
        known = [one for one in list(columns)[:_MOST_COMPARED] if len(one) <= _LONGEST]
        error = UnknownNameError("column", entry.column[:_LONGEST], known)
        raise RecordingError(mapping.source, f"{log.source} has no such column: {error}")
    column = columns[name]
    stated = entry.unit or column.unit or labels.parse(column.name).unit
    return Pick(column, entry.signal, _unit(log, column, stated), component, entry)


def _unit(log: Log, column: Column, stated: str | None) -> Unit | None:
    if stated is None:
        return None
    try:
        return units.parse(stated)
    except ValueError:
        raise RecordingError(
            log.source,
            f"its unit {stated[:40]!r} is not known",
            element=repr(column.name),
            remedy="say in a map what it is in (orbisim recording init)",
        ) from None


def _check_apart(log: Log, picks: Sequence[Pick]) -> None:
    """Raises `RecordingError` if two columns are the same signal."""
    seen: dict[str, Pick] = {}
    for pick in picks:
        if pick.signal in seen:
            _refuse_two(log, seen[pick.signal], pick)
        seen[pick.signal] = pick


def _refuse_two(log: Log, one: Pick, other: Pick) -> None:
    raise RecordingError(
        log.source,
        f"{one.column.name!r} and {other.column.name!r} are both {one.signal!r}",
        remedy="choose one in a map (orbisim recording init)",
    )


# -- their samples -----------------------------------------------------------------------------


def _part(
    log: Log, group: str, picks: Sequence[Pick], chosen: Pick | None, used: set[str]
) -> Contents:
    """The signals that were sampled together. `used` takes the names of the columns."""
    clock = clocks.clock_of(log, group) if chosen is None else _clock_of_map(log, chosen)
    wanted = {pick.column.name for pick in picks}
    if clock.column is not None:
        wanted.add(clock.column.name)
    arrays = log.read([name for name in log.names if name in wanted])
    used |= wanted
    notes = [clock.note]
    if clock.column is None:
        time = log.clocks[group]
    else:
        raw = _component(log, chosen, arrays) if chosen else arrays[clock.column.name]
        raw = _scaled(raw, chosen.entry if chosen else None)
        time, note = clocks.seconds(raw, clock.unit, log.source, clock.column.name)
        notes.append(note)
    signals, stated = _signals(log, picks, arrays)
    return Contents(
        time=_own(time),
        signals={name: _own(values) for name, values in signals.items()},
        units=stated,
        source=log.source,
        notes=tuple(note for note in notes if note),
    )


def _clock_of_map(log: Log, pick: Pick) -> clocks.Clock:
    unit = pick.unit or units.parse("s")
    if unit.si not in ("s", units.AS_IT_IS):
        raise RecordingError(
            log.source, f"{unit.text!r} is no unit of time", element=repr(pick.column.name)
        )
    return clocks.Clock(pick.column, unit)


def _signals(
    log: Log, picks: Sequence[Pick], arrays: Mapping[str, Array]
) -> tuple[dict[str, Array], dict[str, str]]:
    """Signals and their SI units, from columns that may be components of them."""
    whole: dict[str, Array] = {}
    parts: dict[str, Array] = {}
    stated: dict[str, str] = {}
    seen = {pick.signal: pick for pick in picks}
    for pick in picks:
        values = _converted(pick, _component(log, pick, arrays))
        if values.dtype.kind not in "fiub":
            raise RecordingError(
                log.source, f"must hold numbers; got {values.dtype}", element=repr(pick.column.name)
            )
        one = values.ndim == 1 and (log.table or pick.entry is not None)
        (parts if one else whole)[pick.signal] = values
        if pick.unit is not None and pick.unit.si != units.AS_IT_IS:
            stated[pick.signal] = pick.unit.si
    for name, columns in _gathered(log, parts).items():
        if name in whole:
            _refuse_two(log, seen[name], seen[columns[0]])
        vector = len(columns) > 1 or name in names.WHOLE
        whole[name] = _stacked([parts[c] for c in columns]) if vector else parts[columns[0]]
        _share_unit(log, name, columns, stated)
    return whole, stated


def _gathered(log: Log, parts: Iterable[str]) -> dict[str, list[str]]:
    try:
        return names.gather(parts)
    except ValueError as error:
        raise RecordingError(log.source, str(error)) from None


def _share_unit(log: Log, name: str, columns: Sequence[str], stated: dict[str, str]) -> None:
    """Puts the unit of the components in the signal's place."""
    kinds = {stated.pop(column, None) for column in columns} - {None}
    if len(kinds) > 1:
        mixed = " and ".join(sorted(filter(None, kinds)))
        problem = f"its components have the units {mixed}"
        raise RecordingError(log.source, problem, element=repr(name))
    for kind in filter(None, kinds):
        stated[name] = kind


def _component(log: Log, pick: Pick | None, arrays: Mapping[str, Array]) -> Array:
    assert pick is not None
    values = np.asarray(arrays[pick.column.name])
    if pick.component is None:
        return values
    if values.ndim != 2 or pick.component >= values.shape[1]:
        raise RecordingError(
            log.source,
            f"has the shape {values.shape}; it has no component {pick.component}",
            element=repr(pick.column.name),
        )
    return values[:, pick.component]


def _scaled(values: Array, entry: Entry | None) -> Array:
    """With the sign, offset and scale of a map."""
    if entry is None or (entry.sign, entry.offset, entry.scale) == (1, 0.0, 1.0):
        return values
    if values.dtype.kind not in "fiub":
        return values
    return np.asarray(entry.sign * entry.scale * (np.asarray(values, np.float64) - entry.offset))


def _converted(pick: Pick, values: Array) -> Array:
    values = _scaled(values, pick.entry)
    if pick.unit is None or values.dtype.kind not in "fiub":  # others are refused by name later
        return values
    return units.converted(values, pick.unit)


def _stacked(columns: Sequence[Array]) -> Array:
    return np.stack(columns, axis=1)


def _own(values: npt.ArrayLike) -> Array:
    """An array that nobody else writes into, so that it need not be copied."""
    array = np.asarray(values)
    array = array if array.base is None else array.view()
    array.flags.writeable = False
    return array


# -- what is said of them ----------------------------------------------------------------------


def _main_group(log: Log, mapping: SignalMap | None, groups: Sequence[str]) -> int | None:
    """Number of the group whose times the map asks for."""
    if mapping is None or mapping.clock is None:
        return None
    for entry in mapping.entries:
        if entry.signal != TIME:
            column = _found(log, mapping, entry).column
            if mapping.clock in (entry.column, column.name):
                return groups.index(column.group)
    mapped = [entry.column for entry in mapping.entries if entry.signal != TIME]
    error = UnknownNameError("column", mapping.clock[:200], mapped)
    raise RecordingError(mapping.source, f"must name a mapped column: {error}", element="'clock'")


def _any_group(log: Log) -> str:
    """A group with a clock, for a recording without signals."""
    groups = list(dict.fromkeys(column.group for column in log.columns))
    for group in groups:
        try:
            clocks.clock_of(log, group)
        except RecordingError:
            continue
        return group
    return ""


def _ignored_notes(ignored: Sequence[str]) -> Iterable[str]:
    if len(ignored) <= _MOST_NOTES:
        return map(_ignored_note, ignored)
    shown = ", ".join(repr(name) for name in ignored[:_MOST_NOTES])
    return [f"ignored {len(ignored)} columns that are not named as signals: {shown}, ..."]


def _ignored_note(name: str) -> str:
    kind, _, target = name.partition("/")
    if not target and kind in names.KINDS:
        return f"ignored {name!r}: a signal is named {kind}/<{names.KINDS[kind]}>"
    return f"ignored {name!r}: not the name of a signal"
