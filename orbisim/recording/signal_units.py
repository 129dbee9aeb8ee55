"""Units that a scene needs its signals in."""

from __future__ import annotations

import mujoco

from orbisim.errors import RecordingError
from orbisim.recording import names, units
from orbisim.recording.joints import Joint, Kind, by_name
from orbisim.recording.recording import Recording


def unit_of(name: str, model: mujoco.MjModel) -> str | None:
    """Unit of a signal; None where the scene does not fix it (controls, sensors, whole arrays).

    The signals of free joints mix units; theirs is None too.
    """
    kind, target = names.split(name)
    if kind in ("xpos", "xquat"):
        return "m" if kind == "xpos" else "1"
    joint = by_name(model).get(target)
    if kind not in ("qpos", "qvel", "torque") or joint is None or joint.kind == Kind.FREE:
        return None
    return _of_joint(kind, joint)


def _of_joint(kind: str, joint: Joint) -> str:
    if kind == "torque":
        return joint.force_unit
    if kind == "qvel":
        return f"{joint.unit}/s"
    return "1" if joint.kind == Kind.BALL else joint.unit


def check_unit(recording: Recording, name: str, model: mujoco.MjModel) -> None:
    """Raises `RecordingError` if the recording states another unit than the scene's."""
    stated, expected = recording.units[name], unit_of(name, model)
    if expected is None:
        return
    try:
        unit = units.parse(stated)
    except ValueError:
        unit = units.Unit(stated, "", 0.0)
    if unit.si != expected or unit.factor != 1.0:
        raise RecordingError(
            recording.source,
            f"states the unit {stated!r}; the scene needs {expected!r}",
            element=repr(name),
            remedy="convert it: recordings are in SI units and radians"
            if unit.si in (expected, "")
            else "this column may belong to another signal",
        )
