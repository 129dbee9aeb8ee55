"""What of a recording a simulation is compared with."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Literal

import numpy as np
import numpy.typing as npt

from orbisim.metrics import rotation_angle
from orbisim.recording.bound import Bound
from orbisim.recording.joints import Joint, Kind, body_label, joints
from orbisim.recording.motion import rotation_noise
from orbisim.recording.noise import noise_std
from orbisim.recording.sensors import sensors

Floats = npt.NDArray[np.float64]
Home = Literal["qpos", "qvel", "torque", "sensordata", "xpos", "xquat"]


@dataclasses.dataclass(frozen=True)
class Signal:
    """A measured signal.

    Attributes:
      name: as in the recording; free joints as `xpos/<body>`, `xquat/<body>`, and the linear and
        angular parts of their velocity as `qvel/<joint>[0:3]` and `[3:6]`.
      unit: of its error.
      home: the array of `Bound` that holds it. where: its columns, or the body's number.
      rotation: whether it is a quaternion.
      position: whether it counts as a joint position.
    """

    name: str
    unit: str
    home: Home
    where: slice | int
    rotation: bool = False
    position: bool = False

    def measured(self, bound: Bound) -> Floats:
        """[T, n] as recorded."""
        values = getattr(bound, self.home)
        return np.asarray(values[self.where] if self.of_body else values[:, self.where])

    @property
    def of_body(self) -> bool:
        """Whether it is the pose of a body."""
        return self.home in ("xpos", "xquat")

    def distance(self, measured: Floats, simulated: Floats) -> Floats:
        """[N]: the norm of the error, or its angle."""
        if self.rotation:
            return rotation_angle(measured, simulated)
        return np.asarray(np.linalg.norm(simulated - measured, axis=1))

    def noise(self, bound: Bound) -> float:
        """Standard deviation of the measurement noise (of a vector: about each axis)."""
        values = self.measured(bound)
        if self.rotation:
            return rotation_noise(bound.time, values)
        each = noise_std(bound.time, values)
        return float(np.sqrt(np.mean(each**2)))


def observed(bound: Bound) -> list[Signal]:
    """The signals that a simulation of the recording can be compared with."""
    found = [
        *(s for joint in joints(bound.model) for s in _of_joint(bound, joint)),
        *_of_bodies(bound),
        *_of_forces(bound),
        *_of_sensors(bound),
    ]
    return [signal for signal in found if np.isfinite(signal.measured(bound)).any()]


def _of_joint(bound: Bound, joint: Joint) -> Iterator[Signal]:
    name = joint.label
    seen, turns = joint.id in bound.measured, joint.id not in bound.unseen_turns
    if joint.scalar:
        if seen:
            yield Signal(f"qpos/{name}", joint.unit, "qpos", joint.q, position=True)
        yield Signal(f"qvel/{name}", f"{joint.unit}/s", "qvel", joint.v)
        return
    if joint.kind == Kind.BALL:
        if seen:
            yield Signal(f"qpos/{name}", "rad", "qpos", joint.q, rotation=True, position=True)
        yield Signal(f"qvel/{name}", "rad/s", "qvel", joint.v)
        return
    body, start = body_label(bound.model, joint.body), joint.v.start
    q = joint.q.start
    if seen:
        yield Signal(f"xpos/{body}", "m", "qpos", slice(q, q + 3), position=True)
    if seen and turns:
        yield Signal(f"xquat/{body}", "rad", "qpos", slice(q + 3, q + 7), rotation=True)
    yield Signal(f"qvel/{name}[0:3]", "m/s", "qvel", slice(start, start + 3))
    yield Signal(f"qvel/{name}[3:6]", "rad/s", "qvel", slice(start + 3, start + 6))


def _of_bodies(bound: Bound) -> Iterator[Signal]:
    free = {j.body for j in joints(bound.model) if j.kind == Kind.FREE}
    for body in bound.xpos:
        if body not in free:
            yield Signal(f"xpos/{body_label(bound.model, body)}", "m", "xpos", body)
    for body in bound.xquat:
        if body not in free:
            name = f"xquat/{body_label(bound.model, body)}"
            yield Signal(name, "rad", "xquat", body, rotation=True)


def _of_forces(bound: Bound) -> Iterator[Signal]:
    """Recorded joint forces that do not drive the simulation."""
    for joint in joints(bound.model):
        if joint.scalar and not bound.applied[joint.v].any():
            yield Signal(f"torque/{joint.label}", joint.force_unit, "torque", joint.v)


def _of_sensors(bound: Bound) -> Iterator[Signal]:
    for one in sensors(bound.model):
        name = f"sensor/{one.label}"
        yield Signal(name, one.unit, "sensordata", one.place, rotation=one.rotation)
