"""Drives: what moves a degree of freedom."""

from __future__ import annotations

import dataclasses
import math

from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.units import DEGREE


@dataclasses.dataclass(frozen=True)
class Drive:
    """A spring and damper towards a target; SI units and radians.

    force = constant + stiffness (target - q) + damping (target_velocity - v), at most `max_force`.

    Attributes:
      prim: where it is authored.
      stiffness: N/m or N m/rad.
      damping: N s/m or N m s/rad.
      target: m or rad.
      target_velocity: m/s or rad/s.
      max_force: N or N m; may be infinite.
      acceleration: whether the gains are per unit of mass or inertia.
      constant: N or N m.
      delay: control steps by which its command is late.
    """

    prim: Prim
    stiffness: float
    damping: float
    target: float = 0.0
    target_velocity: float = 0.0
    max_force: float = math.inf
    acceleration: bool = False
    constant: float = 0.0
    delay: int = 0


def read_drive(context: Context, prim: Prim, token: str, kind: str) -> Drive | None:
    """A `PhysicsDriveAPI` instance on a joint; None if it is not applied.

    Angular gains are per degree; targets are degrees and degrees per second. The gains of an
    acceleration drive have no mass in them.

    Raises:
      SceneError: a gain or the largest force is negative.
    """
    if not prim.has(f"PhysicsDriveAPI:{token}") and not _is_authored(prim, token):
        return None
    stem = f"drive:{token}:physics:"
    angular = kind != "slide"
    acceleration = prim.choice(f"{stem}type", ("force", "acceleration"), "force") == "acceleration"
    units = context.units
    force = units.inertia if angular else units.force
    unit = DEGREE if angular else units.length
    gain = (1.0 if angular else units.length) / unit if acceleration else force / unit
    return Drive(
        prim=prim,
        stiffness=_gain(prim, f"{stem}stiffness", gain),
        damping=_gain(prim, f"{stem}damping", gain),
        target=prim.number(f"{stem}targetPosition", unit) or 0.0,
        target_velocity=prim.number(f"{stem}targetVelocity", unit) or 0.0,
        max_force=_max_force(prim, f"{stem}maxForce", force),
        acceleration=acceleration,
    )


def _is_authored(prim: Prim, token: str) -> bool:
    """Whether a drive has gains although its schema is not listed as applied."""
    return any(prim.authored(f"drive:{token}:physics:{name}") for name in ("stiffness", "damping"))


def _gain(prim: Prim, name: str, factor: float) -> float:
    value = prim.number(name, factor) or 0.0
    if value < 0:
        raise prim.error(f"{name} is {value}; expected a gain that is not negative")
    return value


def _max_force(prim: Prim, name: str, factor: float) -> float:
    value = prim.number(name, factor, infinite=True)
    if value is None:
        return math.inf
    if value < 0:
        raise prim.error(f"{name} is {value}; expected a force that is not negative")
    return value
