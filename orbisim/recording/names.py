"""Names of signals, and of the columns that hold them in tables.

| signal | samples | target |
| --- | --- | --- |
| `qpos`, `qvel`, `ctrl`, `sensordata` | [T, n] | the scene's own order |
| `qpos/<joint>` | [T]; ball [T, 4], free [T, 7] | joint |
| `qvel/<joint>` | [T]; ball [T, 3], free [T, 6] | joint |
| `ctrl/<actuator>` | [T] | actuator |
| `torque/<joint>` | [T]; ball [T, 3], free [T, 6] | joint |
| `xpos/<body>` | [T, 3] | body |
| `xquat/<body>` | [T, 4], w x y z | body |
| `sensor/<sensor>` | [T] or [T, n] | sensor |

In tables the columns of `xpos` end in `/x`, `/y`, `/z` and those of `xquat` in `/w`, `/x`, `/y`,
`/z`; the columns of every other vector end in its index in brackets: `qpos[0]`, `qpos/ball[3]`.
A vector of one component may do without.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

WHOLE = ("qpos", "qvel", "ctrl", "sensordata")
"""Signals that hold everything of their kind in the scene's order."""

KINDS: Mapping[str, str] = {
    "qpos": "joint",
    "qvel": "joint",
    "ctrl": "actuator",
    "torque": "joint",
    "xpos": "body",
    "xquat": "body",
    "sensor": "sensor",
}
"""Kinds of named signals and what they belong to."""

HELD = ("ctrl", "torque")
"""Kinds that keep their value until the next sample; all others are sampled continuous signals."""

_LETTERS: Mapping[str, str] = {"xpos": "xyz", "xquat": "wxyz"}
_INDEX = re.compile(r"(?s)(.+)\[(\d{1,9})\]")


def split(name: str) -> tuple[str, str]:
    """Kind and target of a signal; the target of a whole array is empty.

    Raises:
      ValueError: the name is not that of a signal.
    """
    kind, slash, target = name.partition("/")
    if (not slash and name in WHOLE) or (target and kind in KINDS):
        return kind, target
    raise ValueError(f"{name!r} is not the name of a signal")


def is_signal(name: str) -> bool:
    """Whether this is the name of a signal."""
    try:
        split(name)
    except ValueError:
        return False
    return True


def is_component(name: str) -> bool:
    """Whether this is the name of a signal, or of a column that holds one component of it."""
    indexed = _INDEX.fullmatch(name)
    return is_signal(name) or bool(indexed and is_signal(indexed[1]))


def columns(name: str, width: int | None) -> list[str]:
    """Names of the columns of a signal [T] (width None) or [T, width]."""
    kind, _ = split(name)
    if kind in _LETTERS and width == len(_LETTERS[kind]):
        return [f"{name}/{letter}" for letter in _LETTERS[kind]]
    if width is None:
        return [f"{name}[0]"] if _INDEX.fullmatch(name) else [name]
    return [f"{name}[{index}]" for index in range(width)]


def gather(headers: Iterable[str]) -> dict[str, list[str]]:
    """The signals that columns belong to, each with its columns in order.

    Headers that are not columns of a signal are left out.

    Raises:
      ValueError: a component is missing, or `xpos` or `xquat` has no component.
    """
    found: dict[str, dict[int, str]] = {}
    for header in headers:
        place = _place(header)
        if place is not None:
            name, index = place
            parts = found.setdefault(name, {})
            if index in parts:
                raise ValueError(f"{parts[index]!r} and {header!r} are the same component")
            parts[index] = header
    for name, parts in found.items():
        kind, _ = split(name)
        expected = columns(name, len(_LETTERS.get(kind, parts)))
        if sorted(parts) != list(range(len(expected))):
            got = ", ".join(sorted(parts.values()))
            raise ValueError(f"{name!r} needs the columns {', '.join(expected)}; got {got}")
    return {name: [parts[i] for i in range(len(parts))] for name, parts in found.items()}


def _place(header: str) -> tuple[str, int] | None:
    """Signal and index of a column; None if it is not one."""
    kind = header.partition("/")[0]
    if kind in _LETTERS:
        name, _, letter = header.rpartition("/")
        if is_signal(name) and len(letter) == 1 and letter in _LETTERS[kind]:
            return name, _LETTERS[kind].index(letter)
        if is_signal(header):
            raise ValueError(
                f"{header!r} is a vector; its columns are "
                + ", ".join(f"'{header}/{letter}'" for letter in _LETTERS[kind])
            )
        return None
    indexed = _INDEX.fullmatch(header)
    if indexed and is_signal(indexed[1]):
        return indexed[1], int(indexed[2])
    return (header, 0) if is_signal(header) else None
