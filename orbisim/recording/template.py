"""A first `map.yaml` for a log and a scene, by likeness of names: `orbisim recording init`."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Container, Iterator, Mapping, Sequence

import mujoco
import numpy as np

from orbisim.errors import RecordingError
from orbisim.recording import clocks, degrees, names, units
from orbisim.recording.actuators import actuators
from orbisim.recording.formats import labels
from orbisim.recording.formats.log import Column, Log
from orbisim.recording.joints import joints
from orbisim.recording.matching import Match, matches, targets
from orbisim.recording.signal_units import unit_of
from orbisim.scene import Scene

_HEAD = """\
# Which column of {log} is which signal of {scene}.
# A first guess by names: check every line. A value of the signal is
#   sign * scale * (column - offset)   in `unit`, converted to SI.
columns:
"""
_SURE = 0.95
"""Likeness of names from which a match needs no remark: they differ in spelling only."""
_MOST_LISTED = 200
"""Signals and columns that are listed in comments."""


@dataclasses.dataclass(frozen=True)
class Proposal:
    """A first map. text: of its file. matched: signals by column. unmatched: other columns."""

    text: str
    matched: Mapping[str, str]
    unmatched: tuple[str, ...]


def propose(log: Log, scene: Scene) -> Proposal:
    """A map with a line for each column that is like a signal, and comments for the rest."""
    times = _times(log)
    rest = [column for column in log.columns if column.name not in times]
    found = matches(_components(rest), scene.model, log.table)
    forces = [match for match in found if match.signal.startswith("torque/")]
    found = [match for match in found if match not in forces]
    matched = {match.column.name: match.signal for match in found}
    rest = [column for column in rest if column.name not in {m.column.name for m in forces}]
    turned = _in_degrees(found, log, scene.model)
    left = [c.name for c in rest if c.name not in matched and not _parts_in(c, matched)]
    lines = [*times.values(), *(_line(match, scene.model, turned) for match in found)]
    lines += _forces(forces, scene.model)
    remarks = _remarks(left, set(matched.values()), scene, log)
    text = _HEAD.format(log=json.dumps(log.source), scene=json.dumps(scene.name))
    text += "".join(f"{line}\n" for line in (*lines, *remarks))
    return Proposal(text, matched, tuple(left))


def _components(columns: Sequence[Column]) -> list[Column]:
    """Columns, and in the place of a wide one of which nothing is known, its components."""
    found: list[Column] = []
    for column in columns:
        wide = column.shape is not None and len(column.shape) == 2
        if not wide or column.signal or column.shape[1] in (3, 4):  # type: ignore[index]
            found.append(column)
            continue
        assert column.shape is not None
        found += [
            Column(f"{column.name}[{i}]", column.shape[:1], column.unit, None, column.group)
            for i in range(min(column.shape[1], _MOST_LISTED))
        ]
    return found


def _parts_in(column: Column, matched: Mapping[str, str]) -> bool:
    return any(name.startswith(f"{column.name}[") for name in matched)


def _times(log: Log) -> dict[str, str]:
    """The line of the time column, if the log has one clock in a column."""
    groups = list(dict.fromkeys(column.group for column in log.columns))
    found: dict[str, str] = {}
    for group in groups:
        try:
            clock = clocks.clock_of(log, group)
        except RecordingError:
            continue
        if clock.column is not None:
            stated = clock.column.unit or labels.parse(clock.column.name).unit
            note = "" if stated else "  # the file names no unit: s?"
            unit = "" if stated is None else f", unit: {_text(stated)}"
            line = f"  {_text(clock.column.name)}: {{signal: time{unit}}}{note}"
            found[clock.column.name] = line
    if len(found) > 1:  # each group keeps its own
        return {name: f"  # {_text(name)} is the time of its group" for name in found}
    return found


def _in_degrees(found: Sequence[Match], log: Log, model: mujoco.MjModel) -> set[str]:
    """Signals without a unit whose values, or those of their joint, are too large for radians."""
    every = {joint.name: joint for joint in joints(model)}
    servos = {a.name: every[_joint_name(model, a.joint)] for a in actuators(model)
              if degrees.commands_angle(a, model)}  # fmt: skip
    turned: set[str] = set()
    for match in found:
        kind, target = names.split(match.signal)
        joint = {"qpos": every, "ctrl": servos}.get(kind, {}).get(target)
        if joint is None or match.column.unit or labels.parse(match.column.name).unit:
            continue
        if degrees.suspect(_values(log, match.column), joint, model):
            turned.add(match.signal)
            if kind == "qpos":
                turned.add(f"qvel/{target}")
    return turned


def _joint_name(model: mujoco.MjModel, index: int) -> str:
    return str(model.joint(index).name)


def _values(log: Log, column: Column) -> np.ndarray:
    """Samples of a column, or of a component `name[3]`; none where they cannot be read."""
    known = {one.name for one in log.columns}
    whole, _, component = column.name.rpartition("[")
    name = column.name if column.name in known else whole
    try:
        values = np.asarray(log.read([name])[name])
    except RecordingError:
        return np.zeros(0)
    if name != column.name and values.ndim == 2:
        values = values[:, int(component.removesuffix("]"))]
    return values if values.dtype.kind in "fiu" else np.zeros(0)


def _forces(found: Sequence[Match], model: mujoco.MjModel) -> Iterator[str]:
    """Forces as comments: many logs hold zeros or currents under such names."""
    if found:
        yield "  # Recorded forces drive their joints where no control is mapped, and the actuators"
        yield "  # are then off. Take these lines only if they are measured forces:"
        yield from (f"  #{_line(match, model)[1:]}" for match in found)


def _line(match: Match, model: mujoco.MjModel, turned: Container[str] = ()) -> str:
    stated = match.column.unit or labels.parse(match.column.name).unit
    expected = _expected(match.signal, model)
    parts = [f"signal: {_text(match.signal)}"]
    remarks = [match.why] if match.why else []
    if match.likeness < _SURE and not match.why:
        remarks.append("by likeness of names")
    if stated is not None:
        parts.append(f"unit: {_text(stated)}")
        if not units.known(stated):
            remarks.append(f"{stated!r} is not a unit that is known: give the scale to one that is")
    elif match.signal in turned:
        unit = "deg/s" if match.signal.startswith("qvel/") else "deg"
        parts.append(f"unit: {_text(unit)}")
        remarks.append(f"the file names no unit; too large for radians: {unit}?")
    elif expected is not None:
        parts.append(f"unit: {_text(expected)}")
        remarks.append(f"the file names no unit: {expected}?")
    else:
        remarks.append("the file names no unit; taken as the scene needs it")
    parts += ["sign: 1", "offset: 0.0"]
    comment = f"  # {'; '.join(remarks)}" if remarks else ""
    return f"  {_text(match.column.name)}: {{{', '.join(parts)}}}{comment}"


def _expected(signal: str, model: mujoco.MjModel) -> str | None:
    """The unit that a signal, or a signal's component, has in the scene."""
    kind, target = names.split(signal)
    whole, _, letter = target.rpartition("/")
    component = kind in ("xpos", "xquat") and whole and len(letter) == 1
    return unit_of(f"{kind}/{whole}" if component else signal, model)


def _remarks(left: Sequence[str], used: set[str], scene: Scene, log: Log) -> Iterator[str]:
    """Comments: columns that were not matched, and signals that have no column."""
    if left:
        yield "  # Columns that are like no signal of the scene:"
        for name in left[:_MOST_LISTED]:
            yield f"  #   {_text(name)}:"
    scalar = {f"qpos/{j.name}" for j in joints(scene.model) if j.scalar}
    free = [t.name for t in targets(scene.model, log.table) if t.name not in used]
    if missing := [name for name in free if name in scalar]:
        yield "  # Positions that the scene needs, and no column is like them:"
        for name in missing[:_MOST_LISTED]:
            yield f"  #   {name}"
    if nameless := [a for a in actuators(scene.model) if a.driven and not a.name]:
        yield "  # Actuators without a name, which no column can drive; give them one in the scene:"
        for actuator in nameless[:_MOST_LISTED]:
            where = scene.model.joint(actuator.joint).name if actuator.joint >= 0 else ""
            yield f"  #   {actuator.label}" + (f" at joint {_text(where)}" if where else "")
    if others := [name for name in free if name not in scalar]:
        yield "  # Further signals of the scene, which may be absent:"
        yield from _wrapped(others[:_MOST_LISTED])


def _wrapped(some: Sequence[str], width: int = 90) -> Iterator[str]:
    line = "  #  "
    for name in some:
        if len(line) + len(name) > width:
            yield line
            line = "  #  "
        line += f" {name}"
    yield line


def _text(name: str) -> str:
    """A YAML scalar on one line."""
    plain = name.replace("/", "").replace("_", "").replace("*", "").isalnum()
    starts = name[:1].isalpha() and name.lower() not in ("null", "true", "false", "yes", "no", "on")
    risky = name.lower() in ("off", "y", "n")
    return name if plain and starts and name.isascii() and not risky else json.dumps(name)
