"""The sensors of a model: their units, and those that read the state itself."""

from __future__ import annotations

import dataclasses
from typing import Literal

import mujoco

from orbisim.recording.joints import joints

Reads = Literal["qpos", "qvel", "xpos", "xquat"]

_UNITS = {
    "ACCELEROMETER": "m/s^2", "GYRO": "rad/s", "VELOCIMETER": "m/s", "FORCE": "N",
    "TORQUE": "N*m", "TOUCH": "N", "FRAMEPOS": "m", "FRAMELINVEL": "m/s", "FRAMEANGVEL": "rad/s",
    "FRAMELINACC": "m/s^2", "FRAMEANGACC": "rad/s^2", "SUBTREECOM": "m", "SUBTREELINVEL": "m/s",
    "RANGEFINDER": "m", "ACTUATORFRC": "N or N*m", "BALLQUAT": "rad", "BALLANGVEL": "rad/s",
    "FRAMEQUAT": "rad", "MAGNETOMETER": "T", "CLOCK": "s",
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Sensor:
    """A sensor.

    Attributes:
      id: its number. name: its name, empty if it has none. kind: MuJoCo's name of its type.
      place: its columns of sensordata.
      unit: of its readings (of the error of an orientation).
      rotation: whether it reads a quaternion.
      delayed: whether the scene gives it a delay or an interval.
      stage: MuJoCo's stage that it needs.
    """

    id: int
    name: str
    kind: str
    place: slice
    unit: str
    rotation: bool
    delayed: bool
    stage: int

    @property
    def label(self) -> str:
        """Its name, or `#number`."""
        return self.name or f"#{self.id}"

    @property
    def width(self) -> int:
        """Number of its columns."""
        return int(self.place.stop - self.place.start)


def sensors(model: mujoco.MjModel) -> tuple[Sensor, ...]:
    """All sensors in the model's order."""
    found = []
    for index in range(model.nsensor):
        start, width = int(model.sensor_adr[index]), int(model.sensor_dim[index])
        kind = mujoco.mjtSensor(model.sensor_type[index]).name.removeprefix("mjSENS_")
        found.append(
            Sensor(
                id=index,
                name=model.sensor(index).name,
                kind=kind,
                place=slice(start, start + width),
                unit=_unit(model, index, kind),
                rotation=width == 4 and kind.endswith("QUAT"),
                delayed=bool(model.sensor_historyadr[index] >= 0),
                stage=int(model.sensor_needstage[index]),
            )
        )
    return tuple(found)


def _unit(model: mujoco.MjModel, index: int, kind: str) -> str:
    if kind in ("JOINTPOS", "JOINTVEL", "JOINTACTFRC"):
        joint = joints(model)[int(model.sensor_objid[index])]
        base = joint.force_unit if kind == "JOINTACTFRC" else joint.unit
        return f"{base}/s" if kind == "JOINTVEL" else base
    return _UNITS.get(kind, "SI")


def reads_state(model: mujoco.MjModel, sensor: Sensor) -> tuple[Reads, int] | None:
    """What of the state a sensor reads, and of which joint or body; None if it reads none.

    A frame sensor reads a pose if it is attached to the body's own frame and refers to the world.
    """
    target = int(model.sensor_objid[sensor.id])
    if sensor.kind in ("JOINTPOS", "BALLQUAT"):
        return "qpos", target
    if sensor.kind in ("JOINTVEL", "BALLANGVEL"):
        return "qvel", target
    own = model.sensor_objtype[sensor.id] == mujoco.mjtObj.mjOBJ_XBODY
    if sensor.kind in ("FRAMEPOS", "FRAMEQUAT") and own and model.sensor_refid[sensor.id] < 0:
        return ("xpos" if sensor.kind == "FRAMEPOS" else "xquat"), target
    return None
