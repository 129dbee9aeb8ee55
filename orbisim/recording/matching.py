"""Which signal of a scene a column of a log may be, by name and unit. Proposals, never taken
without being asked: what comes of them is a first map, or the end of an error message."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import re
from collections.abc import Iterable, Sequence

import mujoco

from orbisim.recording import names, units
from orbisim.recording.actuators import actuators
from orbisim.recording.formats import labels
from orbisim.recording.formats.log import Column
from orbisim.recording.joints import Kind, body_label, joints
from orbisim.recording.sensors import sensors
from orbisim.recording.signal_units import unit_of

_WORDS = {
    "qpos": "q qpos pos position positions angle angles theta encoder enc",
    "qvel": "qd dq qdot qvel vel velocity velocities speed omega rate",
    "torque": "tau torque torques effort force trq load",
    "ctrl": "cmd command commands ctrl control u action actions des desired target ref reference "
    "setpoint input goal",
    "xpos": "xpos pos position translation xyz",
    "xquat": "xquat quat quaternion orientation rotation",
    "sensor": "sensor meas measured measurement sens",
}
"""What the kinds of signals are called in logs."""
_FILLER = frozenset(
    {"joint", "joints", "motor", "actuator", "servo", "axis"}
    | {"observation", "data", "state", "states"}
)
"""Words that say little."""
_KINDS_OF_UNIT = {
    "rad": ("qpos", "ctrl"), "m": ("qpos", "xpos", "ctrl"),
    "rad/s": ("qvel", "ctrl", "sensor"), "m/s": ("qvel", "ctrl", "sensor"),
    "N*m": ("torque", "ctrl", "sensor"), "N": ("torque", "ctrl", "sensor"),
    "m/s^2": ("sensor",), "V": ("ctrl", "sensor"), "A": ("ctrl", "sensor"),
    "T": ("sensor",), "rad/s^2": ("sensor",),
}  # fmt: skip
_CLOSE = 0.6
"""Likeness from which on a match is proposed (as difflib's own cutoff)."""
_SUFFIX = 0.85
"""Likeness of names of which one contains the other."""
_SECOND = 0.99
"""Of a name that says several kinds, the likeness of those that it does not say first."""
_MOST_COLUMNS = 1000
"""Each is compared with each signal; tables of robots have some tens or hundreds."""
_LONGEST = 100
"""Characters of a name that are compared."""
_TOKEN = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")


@dataclasses.dataclass(frozen=True)
class Target:
    """A signal that a scene could have in a recording. name: with its kind. width: components.
    unit: in SI, None where the scene does not fix it."""

    name: str
    width: int
    unit: str | None = None


@dataclasses.dataclass(frozen=True)
class Match:
    """A proposal. why: what speaks for it, if that is not the name."""

    column: Column
    signal: str
    likeness: float
    why: str = ""


def targets(model: mujoco.MjModel, table: bool = False) -> list[Target]:
    """All named signals of a scene; of poses, in a table, their components."""
    found = []
    for joint in joints(model):
        if joint.name:
            nq, nv = joint.q.stop - joint.q.start, joint.v.stop - joint.v.start
            for kind, width in (("qpos", nq), ("qvel", nv), ("torque", nv)):
                name = f"{kind}/{joint.name}"
                found.append(Target(name, width, unit_of(name, model)))
    for one in actuators(model):
        if one.name and one.driven:
            found.append(Target(f"ctrl/{one.name}", one.ctrl.stop - one.ctrl.start))
    for index in range(1, model.nbody):
        if model.body(index).name:
            label = body_label(model, index)
            for kind, width in (("xpos", 3), ("xquat", 4)):
                name = f"{kind}/{label}"
                parts = names.columns(name, width)
                found += [Target(p, 1) for p in parts] if table else [Target(name, width)]
    found += [Target(f"sensor/{s.name}", s.width) for s in sensors(model) if s.name]
    return found


def matches(columns: Iterable[Column], model: mujoco.MjModel, table: bool = False) -> list[Match]:
    """The most likely signal of each column, each signal once, in the order of the columns.

    Args:
      columns: of a log. model: of the scene. table: whether each column is one component.
    """
    columns, aims = list(columns)[:_MOST_COLUMNS], targets(model, table)
    scored = sorted(
        (
            Match(column, target.name, likeness(column, target))
            for column in columns
            for target in aims
            if _fits(column, target)
        ),
        key=lambda match: -match.likeness,
    )
    found: dict[str, Match] = {}
    taken: set[str] = set()
    for match in scored:
        if match.likeness < _CLOSE:
            break
        if match.column.name not in found and match.signal not in taken:
            found[match.column.name] = match
            taken.add(match.signal)
    left = [column for column in columns if column.name not in found]
    for match in (*_in_order(left, model, taken), *_last_ones(left, aims, taken)):
        if match.column.name not in found and match.signal not in taken:
            found[match.column.name] = match
            taken.add(match.signal)
    return [found[column.name] for column in columns if column.name in found]


def likeness(column: Column, target: Target) -> float:
    """How much a column is like a signal, 0 to 1: its words, and its unit."""
    traits = _traits(column)
    if target.name in (column.signal, traits.name):
        return 1.0
    kind, place = names.split(target.name)
    if traits.said and kind not in traits.said:
        return 0.0
    if target.unit and traits.unit and traits.unit != target.unit:
        return 0.0
    wanted, kinds = _words(place), traits.kinds
    if kinds and traits.words == wanted:
        return 0.9  # a sensor that is called encoder
    spoken = {word for each in kinds for word in _WORDS[each].split()}
    rest = tuple(word for word in traits.words if word not in spoken or word in wanted)
    rest = tuple(word for word in rest if word not in _FILLER or word in wanted) or rest
    agreed = kind in kinds if kinds else kind in (traits.said or ("qpos", "ctrl"))[:1]
    first = not kinds or kind == kinds[0] or not agreed  # `action/elbow.torque`: a control first
    factor = (1.0 if first else _SECOND) if agreed else 0.75 if not kinds else 0.5
    return _alike(rest, wanted) * factor


@functools.lru_cache(100_000)
def _alike(words: tuple[str, ...], wanted: tuple[str, ...]) -> float:
    """Likeness of two names, 0 to 1."""
    if any(map(str.isalpha, wanted)) and not any(map(str.isalpha, words)):
        return 0.0  # numbers alone: see _in_order
    within = set(wanted) <= set(words) or set(words) <= set(wanted)
    return max(
        _SUFFIX * within, difflib.SequenceMatcher(None, "".join(words), "".join(wanted)).ratio()
    )


@dataclasses.dataclass(frozen=True)
class _Traits:
    """What a column's name says.

    Attributes:
      name: without unit. words: of it. kinds: that the words name. unit: in SI.
      said: kinds of signals that have such a unit.
    """

    name: str
    words: tuple[str, ...]
    kinds: tuple[str, ...]
    unit: str | None
    said: tuple[str, ...]


@functools.lru_cache(10_000)
def _traits(column: Column) -> _Traits:
    label = labels.parse(column.name)
    words = _words(column.name)
    unit = _in_si(column.unit or label.unit)
    return _Traits(label.name, words, _kinds(words), unit, _KINDS_OF_UNIT.get(unit or "", ()))


def _fits(column: Column, target: Target) -> bool:
    """Whether the widths agree; a column of a table may be a component of a vector, by name."""
    width = column.shape[1] if column.shape is not None and len(column.shape) == 2 else 1
    return width == target.width


def _in_order(columns: Sequence[Column], model: mujoco.MjModel, taken: set[str]) -> Iterable[Match]:
    """Numbered columns, as many as there are joints or actuators: in the scene's order."""
    families: dict[str, list[Column]] = {}
    for column in columns:
        stem = re.sub(r"\d+", "#", labels.parse(column.name).name)
        if stem.count("#") == 1:
            families.setdefault(stem, []).append(column)
    for stem, family in families.items():
        numbers = [int(re.findall(r"\d+", labels.parse(c.name).name)[0]) for c in family]
        order = [column for _, column in sorted(zip(numbers, family, strict=True), key=_first)]
        for kind in _kinds(_words(stem)) or ("qpos",):
            aims = _scalars(kind, model)
            if len(aims) == len(order) and not taken & set(aims):
                why = "by its number, in the scene's order"
                yield from (Match(c, a, _CLOSE, why) for c, a in zip(order, aims, strict=True))
                break


def _first(pair: tuple[int, Column]) -> int:
    return pair[0]


def _scalars(kind: str, model: mujoco.MjModel) -> list[str]:
    if kind == "ctrl":
        return [f"ctrl/{a.name}" for a in actuators(model) if a.driven]
    if kind in ("qpos", "qvel", "torque"):
        return [f"{kind}/{j.name}" for j in joints(model) if j.kind in (Kind.HINGE, Kind.SLIDE)]
    return []


def _last_ones(
    columns: Sequence[Column], aims: Sequence[Target], taken: set[str]
) -> Iterable[Match]:
    """The only column of a kind that is left, where one signal of the kind is left."""
    for kind in ("qpos", "qvel", "ctrl", "torque"):
        free = [t.name for t in aims if t.name.startswith(f"{kind}/") and t.name not in taken]
        mine = [c for c in columns if kind in _traits(c).kinds[:1]]
        said = [c for c in mine if kind in (_traits(c).said or (kind,))]
        if len(free) == 1 and len(said) == 1:
            yield Match(said[0], free[0], _CLOSE, "the only one of its kind")


@functools.lru_cache(10_000)
def _words(name: str) -> tuple[str, ...]:
    found = _TOKEN.findall(labels.parse(name).name[:_LONGEST])
    return tuple(word.lower() for word in found)


def _kinds(words: Sequence[str]) -> tuple[str, ...]:
    """Kinds that the words name; controls first, as in `position_command`."""
    named = [kind for kind, some in _WORDS.items() if set(words) & set(some.split())]
    return tuple(sorted(named, key=lambda kind: kind != "ctrl"))


def _in_si(text: str | None) -> str | None:
    """The SI unit of what is written in a unit; None if it is not known."""
    try:
        return units.parse(text).si if text else None
    except ValueError:
        return None
