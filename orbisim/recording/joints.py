"""The joints of a model by name, with where they stand in qpos and qvel."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping

import mujoco


class Kind(enum.IntEnum):
    """MuJoCo's joint types."""

    FREE = 0
    BALL = 1
    SLIDE = 2
    HINGE = 3


_WIDTHS = {Kind.FREE: (7, 6), Kind.BALL: (4, 3), Kind.SLIDE: (1, 1), Kind.HINGE: (1, 1)}


@dataclasses.dataclass(frozen=True)
class Joint:
    """A joint.

    Attributes:
      id: its number. name: its name, empty if it has none.
      kind: its type. body: number of the body that it moves.
      q, v: its slices of qpos and qvel.
    """

    id: int
    name: str
    kind: Kind
    body: int
    q: slice
    v: slice

    @property
    def label(self) -> str:
        """Its name, or `#number`."""
        return self.name or f"#{self.id}"

    @property
    def scalar(self) -> bool:
        """Whether it is a hinge or a slide."""
        return self.kind in (Kind.HINGE, Kind.SLIDE)

    @property
    def quat(self) -> slice | None:
        """Where its quaternion stands in qpos."""
        if self.kind == Kind.FREE:
            return slice(self.q.start + 3, self.q.stop)
        return self.q if self.kind == Kind.BALL else None

    @property
    def angular(self) -> slice | None:
        """Where its body-frame angular velocity stands in qvel."""
        if self.kind == Kind.FREE:
            return slice(self.v.start + 3, self.v.stop)
        return self.v if self.kind == Kind.BALL else None

    @property
    def unit(self) -> str:
        """Unit of its position (of the translation of a free joint)."""
        return "m" if self.kind in (Kind.SLIDE, Kind.FREE) else "rad"

    @property
    def force_unit(self) -> str:
        """Unit of its generalized force."""
        return "N" if self.unit == "m" else "N*m"


def joints(model: mujoco.MjModel) -> tuple[Joint, ...]:
    """All joints in the model's order."""
    found = []
    for index in range(model.njnt):
        kind = Kind(model.jnt_type[index])
        nq, nv = _WIDTHS[kind]
        q, v = int(model.jnt_qposadr[index]), int(model.jnt_dofadr[index])
        name, body = model.joint(index).name, int(model.jnt_bodyid[index])
        found.append(Joint(index, name, kind, body, slice(q, q + nq), slice(v, v + nv)))
    return tuple(found)


def by_name(model: mujoco.MjModel) -> Mapping[str, Joint]:
    """The joints that have names."""
    return {joint.name: joint for joint in joints(model) if joint.name}


def body_label(model: mujoco.MjModel, body: int) -> str:
    """Name of a body, or `#number`."""
    return model.body(body).name or f"#{body}"
