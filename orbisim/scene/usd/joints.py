"""Joint prims: their frames, and the degrees of freedom that they leave."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping

import numpy as np

from orbisim.scene.usd.attributes import Prim, bounded
from orbisim.scene.usd.bodies import Bodies
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.drives import Drive, read_drive
from orbisim.scene.usd.pose import Pose
from orbisim.scene.usd.units import DEGREE

_AXES = "XYZ"
JOINT_TYPES = (
    "PhysicsJoint",
    "PhysicsFixedJoint",
    "PhysicsRevoluteJoint",
    "PhysicsPrismaticJoint",
    "PhysicsSphericalJoint",
    "PhysicsDistanceJoint",
)
HINGE, SLIDE, BALL = "hinge", "slide", "ball"


@dataclasses.dataclass(frozen=True)
class Dof:
    """One elementary joint of a chain.

    Attributes:
      kind: "slide", "hinge" or "ball".
      axis: 0, 1 or 2: the axis of the joint frame.
      token: how limits and drives call it (`rotX`, `angular` ...).
      range: lower and upper limit, m or rad; for a ball 0 and the largest angle; None if free.
      drive: what drives it.
    """

    kind: str
    axis: int
    token: str
    range: tuple[float, float] | None = None
    drive: Drive | None = None


@dataclasses.dataclass(frozen=True)
class Joint:
    """A joint between two bodies, or a body and the world.

    Attributes:
      prim: what it is made from.
      body0: path of the body, or None for the world.
      body1: path of the body, or None for the world.
      frame0: the joint frame relative to body0; m.
      frame1: the joint frame relative to body1; m.
      dofs: from the side of body0 to the side of body1; empty for a fixed joint.
      free: whether it leaves all six degrees of freedom.
      distance: limits of the distance between the frames, m, for a distance joint.
      in_tree: whether it may become part of a kinematic tree.
    """

    prim: Prim
    body0: str | None
    body1: str | None
    frame0: Pose
    frame1: Pose
    dofs: tuple[Dof, ...]
    free: bool = False
    distance: tuple[float, float] | None = None
    in_tree: bool = True

    @property
    def path(self) -> str:
        """Path of the prim."""
        return self.prim.path

    @property
    def type_name(self) -> str:
        """Type of the prim."""
        return self.prim.flat.type_name

    @property
    def is_driven(self) -> bool:
        """Whether it has drives or limits, which only a joint of a tree can carry."""
        return any(dof.drive or dof.range for dof in self.dofs)


@dataclasses.dataclass(frozen=True)
class _Freedom:
    dofs: tuple[Dof, ...]
    free: bool = False
    distance: tuple[float, float] | None = None


def read_joints(context: Context, bodies: Bodies) -> list[Joint]:
    """All enabled joints that hold at least one body, in the stage's order."""
    found = []
    for prim in context.of_type(*JOINT_TYPES):
        joint = _read(context, bodies, prim)
        if joint is not None:
            found.append(joint)
    return found


def _read(context: Context, bodies: Bodies, prim: Prim) -> Joint | None:
    path0, path1 = (context.target(prim, f"physics:body{side}") for side in (0, 1))
    body0, body1 = (_owner(bodies, path) for path in (path0, path1))
    if is_equality(prim):
        return None
    freedom = _FREEDOMS[prim.flat.type_name](context, prim)
    frame0, frame1 = (
        frame_on(context, prim, side, path, body)
        for side, path, body in ((0, path0, body0), (1, path1, body1))
    )
    _report_breaking(context, prim)
    if not prim.flag("physics:jointEnabled", True):
        context.omit(prim.path, "physics:jointEnabled is false", "the joint is left out")
        return None
    if body0 == body1:
        what = "two parts of the same body" if body0 else "no rigid body"
        context.omit(prim.path, f"{prim.flat.type_name} that joins {what}", "left out")
        return None
    excluded = prim.flag("physics:excludeFromArticulation", False)
    return Joint(
        prim, body0, body1, frame0, frame1, freedom.dofs, freedom.free, freedom.distance,
        in_tree=not excluded,
    )  # fmt: skip


def is_equality(prim: Prim) -> bool:
    """Whether MuJoCo's schema says that a joint prim stands for an equality constraint."""
    return prim.has("MjcEqualityWeldAPI") or prim.has("MjcEqualityConnectAPI")


def _owner(bodies: Bodies, path: str | None) -> str | None:
    body = bodies.owner(path) if path is not None else None
    return body.path if body else None


def frame_on(context: Context, prim: Prim, side: int, path: str | None, body: str | None) -> Pose:
    """The joint frame relative to a body (the world for None).

    Args:
      context: the stage.
      prim: the joint.
      side: 0 or 1.
      path: what the joint's relationship leads to; its scale applies to the frame's position.
      body: path of the body that this moves with.
    """
    pos = prim.numbers(f"physics:localPos{side}", 3)
    local = Pose(np.zeros(3) if pos is None else pos, prim.rotation(f"physics:localRot{side}"))
    placement = context.units.place(np.eye(4)) if path is None else context.relative(path, body)
    return placement.pose @ Pose(placement.point(local.pos), local.quat)


def _report_breaking(context: Context, prim: Prim) -> None:
    for name in ("physics:breakForce", "physics:breakTorque"):
        value = prim.number(name, infinite=True)
        if value is not None and math.isfinite(value):
            context.omit(prim.path, f"{name} {value:g}", "the joint does not break")


def _fixed(context: Context, prim: Prim) -> _Freedom:
    return _Freedom(())


def _revolute(context: Context, prim: Prim) -> _Freedom:
    return _Freedom(_single(context, prim, HINGE, "angular", DEGREE))


def _prismatic(context: Context, prim: Prim) -> _Freedom:
    return _Freedom(_single(context, prim, SLIDE, "linear", context.units.length))


def _single(context: Context, prim: Prim, kind: str, token: str, factor: float) -> tuple[Dof, ...]:
    axis = _AXES.index(prim.choice("physics:axis", tuple(_AXES), "X"))
    low = prim.number("physics:lowerLimit", factor, infinite=True)
    high = prim.number("physics:upperLimit", factor, infinite=True)
    specific = f"{'rot' if kind == HINGE else 'trans'}{_AXES[axis]}"
    drive = read_drive(context, prim, token, kind) or read_drive(context, prim, specific, kind)
    dof = Dof(kind, axis, token, drive=drive)
    return _limited(dof, -math.inf if low is None else low, math.inf if high is None else high)


def _limited(dof: Dof, low: float, high: float) -> tuple[Dof, ...]:
    """The dof within its limits; nothing if they lock it."""
    if low > high:
        return ()
    if low == -math.inf and high == math.inf:
        return (dof,)
    if low == high:
        high = low + 1e-9  # MuJoCo wants a range; a locked dof would lose its position
    return (dataclasses.replace(dof, range=(bounded(low), bounded(high))),)


def _spherical(context: Context, prim: Prim) -> _Freedom:
    """MuJoCo limits the whole angle of a ball joint, UsdPhysics only that of its axis."""
    angles = [prim.number(f"physics:coneAngle{i}Limit", DEGREE, infinite=True) for i in (0, 1)]
    axis = _AXES.index(prim.choice("physics:axis", tuple(_AXES), "X"))
    cones = [angle for angle in angles if angle is not None and 0 <= angle < math.inf]
    if not cones:
        return _Freedom((Dof(BALL, axis, "angular"),))
    if not context.for_mujoco:
        context.omit(
            prim.path,
            "physics:coneAngle0Limit, physics:coneAngle1Limit",
            "the larger one bounds the whole rotation, twist included",
        )
    return _Freedom((Dof(BALL, axis, "angular", range=(0.0, max(cones))),))


def _distance(context: Context, prim: Prim) -> _Freedom:
    factor = context.units.length
    low = prim.number("physics:minDistance", factor, infinite=True)
    high = prim.number("physics:maxDistance", factor, infinite=True)
    low = low if low is not None and low >= 0 else 0.0
    high = high if high is not None and high >= 0 else math.inf
    return _Freedom((), distance=(low, bounded(high)))


def _generic(context: Context, prim: Prim) -> _Freedom:
    """Any combination of free, limited and locked axes."""
    slides = [dof for axis in range(3) for dof in _axis_dof(context, prim, SLIDE, axis)]
    hinges = [dof for axis in range(3) for dof in _axis_dof(context, prim, HINGE, axis)]
    plain = not any(dof.range or dof.drive for dof in (*slides, *hinges))
    if prim.has("PhysicsLimitAPI:distance"):
        context.omit(prim.path, "PhysicsLimitAPI:distance", "the distance is not limited")
    if len(slides) == len(hinges) == 3 and plain:
        return _Freedom((), free=True)
    if len(hinges) == 3 and not any(dof.range or dof.drive for dof in hinges):
        return _Freedom((*slides, Dof(BALL, 0, "rot")))
    return _Freedom((*slides, *hinges))


def _axis_dof(context: Context, prim: Prim, kind: str, axis: int) -> tuple[Dof, ...]:
    token = f"{'rot' if kind == HINGE else 'trans'}{_AXES[axis]}"
    factor = DEGREE if kind == HINGE else context.units.length
    low = prim.number(f"limit:{token}:physics:low", factor, infinite=True)
    high = prim.number(f"limit:{token}:physics:high", factor, infinite=True)
    dof = Dof(kind, axis, token, drive=read_drive(context, prim, token, kind))
    return _limited(dof, -math.inf if low is None else low, math.inf if high is None else high)


_FREEDOMS: Mapping[str, Callable[[Context, Prim], _Freedom]] = {
    "PhysicsJoint": _generic,
    "PhysicsFixedJoint": _fixed,
    "PhysicsRevoluteJoint": _revolute,
    "PhysicsPrismaticJoint": _prismatic,
    "PhysicsSphericalJoint": _spherical,
    "PhysicsDistanceJoint": _distance,
}
