"""Rigid bodies, and which prims belong to which."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.flat import FloatArray, ancestors
from orbisim.scene.usd.pose import Placement, Pose
from orbisim.scene.usd.units import DEGREE


@dataclasses.dataclass(frozen=True)
class Body:
    """A rigid body.

    Attributes:
      prim: what it is made from.
      placement: where it is; its frame is the prim's without scale.
      kinematic: whether it moves only as it is told.
      velocity: [3] linear, m/s, world axes.
      spin: [3] angular, rad/s, world axes.
      gravcomp: share of its weight that is compensated.
    """

    prim: Prim
    placement: Placement
    kinematic: bool
    velocity: FloatArray
    spin: FloatArray
    gravcomp: float

    @property
    def path(self) -> str:
        """Path of the prim."""
        return self.prim.path

    @property
    def pose(self) -> Pose:
        """Where its frame is in the world."""
        return self.placement.pose

    @property
    def moves(self) -> bool:
        """Whether it starts with a velocity."""
        return bool(self.velocity.any() or self.spin.any())


class Bodies:
    """The rigid bodies of a stage by path, in the stage's order."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self.all: Mapping[str, Body] = {
            prim.path: _read_body(context, prim)
            for prim in context.with_schema("PhysicsRigidBodyAPI")
            if _is_enabled(context, prim)
        }

    def owner(self, path: str) -> Body | None:
        """The body that a prim moves with, or None if it is part of the world.

        A prim that resets the transform stack does not move with the bodies above it.
        """
        for step in ancestors(path):
            if step in self.all:
                return self.all[step]
            if step in self._context.prims and self._context.prims[step].flat.resets:
                return None
        return None

    def pose_in(self, path: str, owner: Body | None) -> Pose:
        """The pose of a prim's frame relative to a body, or the world."""
        return self._context.relative(path, owner.path if owner else None).pose


def _is_enabled(context: Context, prim: Prim) -> bool:
    if prim.flag("physics:rigidBodyEnabled", True):
        return True
    context.warn("physics:rigidBodyEnabled is false; it is part of the world", prim.path)
    return False


def _read_body(context: Context, prim: Prim) -> Body:
    placement = context.place(prim.path)
    if placement.shears:
        context.warn("its transform shears; its frame is the closest rotation", prim.path)
    if prim.flag("physics:startsAsleep", False):
        context.omit(prim.path, "physics:startsAsleep", "it starts awake")
    owner = context.target(prim, "physics:simulationOwner")
    scenes = context.of_type("PhysicsScene")
    if owner is not None and scenes and owner != scenes[0].path:
        context.omit(prim.path, f"physics:simulationOwner <{owner}>", "simulated with the rest")
    gravcomp = prim.number("mjc:body:gravcomp")
    if prim.flag("physxRigidBody:disableGravity", False) and gravcomp is None:
        gravcomp = 1.0
    return Body(
        prim=prim,
        placement=placement,
        kinematic=prim.flag("physics:kinematicEnabled", False),
        velocity=_velocity(context, prim, "physics:velocity", context.units.length),
        spin=_velocity(context, prim, "physics:angularVelocity", DEGREE),
        gravcomp=gravcomp or 0.0,
    )


def _velocity(context: Context, prim: Prim, name: str, factor: float) -> FloatArray:
    """A velocity in world axes; authored "in the same space as the node's xform"."""
    local = prim.numbers(name, 3, factor)
    if local is None:
        return Pose().pos
    parent = prim.path.rpartition("/")[0]
    if prim.flat.resets or parent not in context.prims:
        return context.units.direction(local)
    return Pose(quat=context.place(parent).pose.quat).apply(local)
