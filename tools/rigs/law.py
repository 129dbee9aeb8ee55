"""What a law of the truth is, and what is known of a machine when its size is drawn."""

from __future__ import annotations

import copy
import dataclasses
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Usual:
    """What the machine does without the law; sizes are drawn relative to it.

    Attributes:
      model: as the truth steps it. force, speed, travel, middle: [nv] typical (root mean square)
        generalized force that moves each degree of freedom, its velocity, half of its travel and
        the middle of that. command: [nu] typical size of each command. drive: [nu] typical output
        of each actuator, before the gear.
    """

    model: mujoco.MjModel
    force: Floats
    speed: Floats
    travel: Floats
    middle: Floats
    command: Floats
    drive: Floats

    def force_of(self, joint: str) -> float:
        """Typical generalized force at a joint, N*m or N."""
        return float(self.force[dof_of(self.model, joint)])

    def speed_of(self, joint: str) -> float:
        """Typical speed of a joint, rad/s or m/s."""
        return float(self.speed[dof_of(self.model, joint)])

    def travel_of(self, joint: str) -> tuple[float, float]:
        """Middle and half of the travel of a joint, rad or m."""
        dof = dof_of(self.model, joint)
        return float(self.middle[dof]), float(self.travel[dof])

    def weight_of(self, body: str) -> float:
        """Of a body and all that it carries, N."""
        return 9.81 * float(self.model.body_subtreemass[index_of(self.model, "body", body)])


class Law:
    """Something that the machine does and its declared scene does not.

    Attributes:
      effect, target: what a user would call it and where; the effect is empty for what has no name
        in the catalogue.
      value: first parameter, SI (angles of a tilt in degrees), by which intervals are judged; NaN
        if there is none.
      size: what was drawn, relative to the machine's usual forces and so on.
      instead: whether it acts in the place of an actuator: commands reach it after all else that
        changes them.
    """

    instead = False

    def __init__(self, effect: str, target: str, value: float, size: float) -> None:
        self.effect, self.target = effect, target
        self.value, self.size = float(value), float(size)

    def ways(self) -> list[Law]:
        """The same, at the same moment, with another number beside its size, for each that whoever
        looks for the effect looks for, too: where a spring rests, where a force points."""
        return []

    def _with(self, **numbers: Any) -> Law:
        """The same, at the same moment, with other attributes."""
        other = copy.deepcopy(self)
        for name, value in numbers.items():
            setattr(other, f"_{name}", value)
        return other

    def tune(self, model: mujoco.MjModel) -> None:
        """Changes numbers of the truth's model; `mj_setConst` follows."""

    def begin(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Forgets: a recording begins at the state of `data`."""

    def command(self, time: float, command: Floats) -> None:
        """Changes the commands [nu] that reach the actuators in place; once a time step."""

    def passive(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Adds to `data.qfrc_passive`; called by MuJoCo at every evaluation of the forces."""

    def advance(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Moves memories on by a time step, after MuJoCo has."""

    def shown(self, qpos: Floats, qvel: Floats) -> None:
        """Replaces in place what the encoders see, where that is not the model's state."""

    def to_json(self) -> dict[str, Any]:
        """For the file of the truth."""
        return {
            "effect": self.effect,
            "kind": type(self).__name__,
            "target": self.target,
            "value": None if np.isnan(self.value) else self.value,
            "size": self.size,
        }


class Reading(Law):
    """A fault of measurement; recordings are made with it, the motion is as declared.

    Attributes:
      offset, factor, delay: of the target joint. clock: of the whole recording.
    """

    offset, factor, delay, clock = 0.0, 1.0, 0.0, 1.0

    def read(self, positions: Floats) -> Floats:
        """What the encoder gives for true positions."""
        return self.factor * positions + self.offset


def name_of(model: mujoco.MjModel, kind: str, index: int) -> str:
    """Of a joint, an actuator ...; without a name `joint3`."""
    return str(getattr(model, kind)(index).name) or f"{kind}{index}"


def dof_of(model: mujoco.MjModel, joint: str) -> int:
    """First degree of freedom of a joint."""
    return int(model.jnt_dofadr[index_of(model, "joint", joint)])


def index_of(model: mujoco.MjModel, kind: str, name: str) -> int:
    """By name, or by `joint3`."""
    count = {"joint": "njnt", "actuator": "nu", "body": "nbody", "geom": "ngeom"}[kind]
    for index in range(getattr(model, count)):
        if name_of(model, kind, index) == name:
            return index
    raise KeyError(f"no {kind} {name!r}")
