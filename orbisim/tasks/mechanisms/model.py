"""What a mechanism is: parts, joints, what locks them, and how a hand operates it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Literal

import numpy as np
import numpy.typing as npt

from orbisim.effects import EffectInstance
from orbisim.tasks.mechanisms.solids import Solid, Vector

Floats = npt.NDArray[np.float64]
BASE = "housing"
"""Name of the part that stands on the table."""


@dataclasses.dataclass(frozen=True)
class Part:
    """A rigid part.

    Attributes:
      solids: in the part's frame. density: kg/m^3. rgb: colour, 0 to 1.
    """

    name: str
    solids: tuple[Solid, ...]
    density: float
    rgb: Vector


@dataclasses.dataclass(frozen=True)
class Joint:
    """A hinge or a slide; the child's frame is the parent's, moved by `pos`, at zero.

    Attributes:
      pos: m. axis: in the parent's frame. lower, upper: rad or m.
      friction: N*m or N. damping: N*m*s/rad or N*s/m.
      stiffness, rest: of a spring that returns it, N*m/rad or N/m, and where it rests.
      armature: kg*m^2 or kg; inertia of what a part of few grams would lack.
    """

    name: str
    kind: Literal["hinge", "slide"]
    parent: str
    child: str
    pos: Vector
    axis: Vector
    lower: float
    upper: float
    friction: float
    damping: float
    stiffness: float = 0.0
    rest: float = 0.0
    armature: float = 0.0


@dataclasses.dataclass(frozen=True)
class Grip:
    """How a hand takes hold of a part.

    Attributes:
      part: which. pos: of the tool's centre point in the part's frame, m.
      approach: the direction in which the tool points. closing: along which the fingers close.
        Both in the part's frame, at right angles.
      clearance: how far before it the hand begins its approach, m.
    """

    part: str
    pos: Vector
    approach: Vector
    closing: Vector
    clearance: float = 0.08

    @property
    def rotation(self) -> Floats:
        """[3, 3]: the tool's axes as columns, in the part's frame."""
        z, y = np.array(self.approach), np.array(self.closing)
        return np.stack([np.cross(y, z), y, z], axis=1)


@dataclasses.dataclass(frozen=True)
class Operation:
    """One stage of operating a mechanism.

    Attributes:
      grip: where the hand holds.
      motions: joint and where it goes, one after another, while the hand holds.
      closed: whether the fingers close around the grip, or are closed before and only push.
      release: whether the hand lets go and withdraws in the end.
    """

    grip: Grip
    motions: tuple[tuple[str, float], ...]
    closed: bool = True
    release: bool = True


@dataclasses.dataclass(frozen=True)
class Mechanism:
    """A mechanism on a table; its base stands in the origin, its front looks along -x.

    Attributes:
      family: such as `door`. number: of the instance.
      parts: the first is the base, which is fixed. joints: one for each other part.
      effects: latches and detents.
      operations: what a hand does with it, in order.
      goal: joint, and the position beyond which (away from zero) the task is done.
      place: where the base stands nominally, x and y in m, z the table's top.
      yaw: of the tool at the start, rad; where it holds upright bars or buttons from above, 0.
      features: numbers that the instance was drawn with.
    """

    family: str
    number: int
    parts: tuple[Part, ...]
    joints: tuple[Joint, ...]
    effects: tuple[EffectInstance, ...]
    operations: tuple[Operation, ...]
    goal: tuple[str, float]
    place: tuple[float, float]
    yaw: float = 0.0
    features: Mapping[str, float] = dataclasses.field(default_factory=dict)

    @property
    def name(self) -> str:
        """Such as `door_03`."""
        return f"{self.family}_{self.number:02d}"


def lock(
    target: str,
    other: str,
    threshold: float,
    *,
    width: float,
    force: float,
    position: float = 0.0,
) -> EffectInstance:
    """A latch that holds `target` at a position until `other` is beyond a threshold (with its
    sign: below -0.5 for -0.5)."""
    return EffectInstance(
        "latch",
        target,
        {"force": force, "position": position, "width": width, "threshold": threshold},
        {"other": other, "side": "above" if threshold > 0 else "below"},
    )


def detents(target: str, amplitude: float, pitch: float, position: float = 0.0) -> EffectInstance:
    """Places a pitch apart that draw a joint to them."""
    values = {"amplitude": amplitude, "pitch": pitch, "position": position}
    return EffectInstance("detent", target, values)


def catch(target: str, force: float, width: float, position: float = 0.0) -> EffectInstance:
    """A place that holds a joint against forces up to `force`."""
    values = {"force": force, "position": position, "width": width, "threshold": 0.0}
    return EffectInstance("latch", target, values)
