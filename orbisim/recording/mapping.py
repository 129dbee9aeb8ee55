"""`map.yaml`: which column of a log is which signal, in which unit.

    columns:
      "timestamp [ms]": time                  # the unit is that of the header
      "yaw_pos [deg]": {signal: qpos/yaw, sign: -1, offset: 12.5}
      yaw_counts: {signal: qpos/yaw, unit: rev, scale: 0.000244140625}
      "pose[3]": xquat/cube/w                 # one component of an array [T, n]

A value of the signal is `sign * scale * (column - offset)` in `unit`, converted to SI. The offset
is thus what the column reads where the signal is zero.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import yaml

from orbisim.errors import InputError, RecordingError, UnknownNameError
from orbisim.files.reading import read_bytes
from orbisim.recording import names, units

_MOST_BYTES = 2**18
"""A map has a line for each column: four thousand of them, where logs have some hundreds."""
_ENTRY = ("signal", "unit", "sign", "offset", "scale")
_TOP = ("columns", "clock")
_EXAMPLE = "columns: {'yaw [deg]': {signal: qpos/yaw, sign: -1}}"
TIME = "time"


@dataclasses.dataclass(frozen=True)
class Entry:
    """What becomes of one column.

    Attributes:
      column: its name. signal: the name of a signal or of a signal's component, or `time`.
      unit: of the column after sign, offset and scale; None: what the file says.
      sign: 1 or -1. offset: in the unit of the column. scale: a factor.
    """

    column: str
    signal: str
    unit: str | None = None
    sign: int = 1
    offset: float = 0.0
    scale: float = 1.0


@dataclasses.dataclass(frozen=True)
class SignalMap:
    """A map.

    Attributes:
      source: its file. entries: in its order.
      clock: the column whose times the recording takes, where the log has several clocks.
    """

    source: str
    entries: tuple[Entry, ...]
    clock: str | None = None

    @classmethod
    def load(cls, path: str | Path) -> SignalMap:
        """Reads a map.

        Raises:
          RecordingError: it is no map; the message says which entry is wrong and what is expected.
        """
        source = str(path)
        try:
            text = read_bytes(path, _MOST_BYTES)
        except InputError as error:
            raise RecordingError(source, str(error).removeprefix(f"{path}: ")) from None
        top = _parsed(text, source)
        columns = top.get("columns")
        _only(top, _TOP, source, None)
        if not isinstance(columns, Mapping) or not columns:
            problem = f"has no columns; a map looks like this: {_EXAMPLE}"
            raise RecordingError(source, problem)
        clock = top.get("clock")
        if clock is not None and not isinstance(clock, str):
            raise RecordingError(source, "must name a column", element="'clock'")
        entries = tuple(_entry(column, value, source) for column, value in columns.items())
        return cls(source, entries, clock)


class _Loader(yaml.SafeLoader):
    """Plain data; a key that stands twice is an error."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Hashable, Any]:
        """A mapping whose keys differ."""
        seen = set()
        for key, _ in node.value:
            if key.value.__hash__ and key.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key.value!r} stands twice", key.start_mark
                )
            seen.add(key.value if key.value.__hash__ else id(key))
        return dict(super().construct_mapping(node, deep))


def _parsed(text: bytes, source: str) -> Mapping[str, Any]:
    try:
        value = yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError, RecursionError, OverflowError) as error:
        problem = " ".join(str(error).split())[:300] or type(error).__name__
        raise RecordingError(source, f"is not YAML: {problem}") from None
    if not isinstance(value, Mapping):
        raise RecordingError(source, f"is not a map; a map looks like this: {_EXAMPLE}")
    return value


def _only(given: Mapping[Any, Any], known: tuple[str, ...], source: str, where: str | None) -> None:
    """Raises `RecordingError` at a key that is not among the known ones."""
    for key in given:
        if key not in known:
            error = UnknownNameError("key", str(key)[:80], known)
            raise RecordingError(source, str(error), element=where)


def _entry(column: Any, value: Any, source: str) -> Entry:
    where = f"column {str(column)[:80]!r}"
    if not isinstance(column, str):
        raise RecordingError(source, "is no name; put it in quotes", element=where)
    given = {"signal": value} if isinstance(value, str) else value
    if not isinstance(given, Mapping) or not isinstance(given.get("signal"), str):
        problem = "must be the name of a signal, or have a 'signal'"
        raise RecordingError(source, problem, element=where, remedy=f"as in {_EXAMPLE}")
    _only(given, _ENTRY, source, where)
    entry = Entry(
        column=column,
        signal=_signal(given["signal"], source, where),
        unit=_unit(given.get("unit"), source, where),
        sign=_sign(given.get("sign", 1), source, where),
        offset=_number("offset", given.get("offset", 0.0), source, where),
        scale=_number("scale", given.get("scale", 1.0), source, where),
    )
    if entry.scale == 0.0:
        raise RecordingError(source, "scale must not be 0", element=where)
    if entry.signal == TIME and entry.sign * entry.scale < 0:
        raise RecordingError(source, "time must not run backwards", element=where)
    return entry


def _signal(name: str, source: str, where: str) -> str:
    if name == TIME or names.is_component(name):
        return name
    kinds = ", ".join(f"{kind}/<{target}>" for kind, target in names.KINDS.items())
    raise RecordingError(
        source,
        f"{name[:80]!r} is not the name of a signal",
        element=where,
        remedy=f"signals are time, {kinds}",
    )


def _unit(value: Any, source: str, where: str) -> str | None:
    if value is None:
        return None
    text = str(value) if isinstance(value, (str, int)) else ""
    if not text or not units.known(text):
        raise RecordingError(
            source,
            f"unit {str(value)[:40]!r} is not known",
            element=where,
            remedy="write it as rad, deg, rpm, mNm, ms ..., or give the scale to one of these",
        )
    return text


def _sign(value: Any, source: str, where: str) -> int:
    known = {1: 1, -1: -1, "+": 1, "-": -1}
    if isinstance(value, bool) or not isinstance(value, (int, str)) or value not in known:
        raise RecordingError(
            source, f"sign must be 1 or -1; got {str(value)[:40]!r}", element=where
        )
    return known[value]


def _number(key: str, value: Any, source: str, where: str) -> float:
    plain = isinstance(value, (int, float)) and not isinstance(value, bool)
    try:
        number = float(value) if plain else math.nan
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        problem = f"{key} must be a finite number; got {str(value)[:40]!r}"
        raise RecordingError(source, problem, element=where)
    return number
