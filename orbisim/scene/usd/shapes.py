"""Geometric prims as MuJoCo geoms."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import mujoco
import numpy as np

from orbisim.scene.usd import solids
from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.flat import FloatArray
from orbisim.scene.usd.pose import Placement, Pose, aligning_z, quat_of
from orbisim.scene.usd.solids import Solid

_EQUAL = 1e-6  # relative difference of scale factors that counts as none
_AXES = {"X": 0, "Y": 1, "Z": 2}
_GEOM = mujoco.mjtGeom


@dataclasses.dataclass(frozen=True)
class Shape:
    """One MuJoCo geom's form.

    Attributes:
      kind: MuJoCo's geom type.
      size: [3] as MuJoCo has it for the type; m.
      pose: relative to the prim's frame.
      solid: the mesh, for meshes; m.
      exact_inertia: for meshes, whether the inertia is that of the mesh, not of its hull.
    """

    kind: mujoco.mjtGeom
    size: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(3))
    pose: Pose = dataclasses.field(default_factory=Pose)
    solid: Solid | None = None
    exact_inertia: bool = False

    @classmethod
    def mesh(cls, solid: Solid, *, exact_inertia: bool = False) -> Shape:
        """A mesh in the prim's frame."""
        return cls(_GEOM.mjGEOM_MESH, solid=solid, exact_inertia=exact_inertia)


Build = Callable[[Context, Prim, Placement], list[Shape]]


def shapes_of(context: Context, prim: Prim) -> list[Shape] | None:
    """The form of a primitive prim (not of a mesh); None if the type is no geometry.

    Raises:
      SceneError: a size is negative, or zero where that leaves nothing.
    """
    build = _BUILDERS.get(prim.flat.type_name)
    return build(context, prim, context.place(prim.path)) if build else None


def _length(prim: Prim, name: str, otherwise: float) -> float:
    value = prim.number(name)
    value = otherwise if value is None else value
    if value < 0:
        raise prim.error(f"{name} is {value}; expected a positive length")
    return value


def _axis(prim: Prim) -> int:
    return _AXES[prim.choice("axis", ("X", "Y", "Z"), "Z")]


def _turned(axis: int) -> FloatArray:
    """[3, 3] rotation that takes z to an axis."""
    return Pose(quat=aligning_z(np.eye(3)[axis])).rotation


def _cube(context: Context, prim: Prim, placement: Placement) -> list[Shape]:
    half = _length(prim, "size", 2.0) / 2
    if placement.shears:
        return [Shape.mesh(solids.box(np.full(3, half)).stretched(placement.stretch))]
    return [Shape(_GEOM.mjGEOM_BOX, half * np.abs(placement.scale))]


def _sphere(context: Context, prim: Prim, placement: Placement) -> list[Shape]:
    return [_ball(_length(prim, "radius", 1.0), placement)]


def _ball(radius: float, placement: Placement) -> Shape:
    """A sphere, or the ellipsoid that the stretch makes of it."""
    if not placement.shears:
        size = radius * np.abs(placement.scale)
        if np.ptp(size) <= _EQUAL * size.max():
            return Shape(_GEOM.mjGEOM_SPHERE, np.array([size[0], 0, 0]))
        return Shape(_GEOM.mjGEOM_ELLIPSOID, size)
    axes, lengths, _ = np.linalg.svd(placement.stretch)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return Shape(_GEOM.mjGEOM_ELLIPSOID, radius * lengths, Pose(quat=quat_of(axes)))


def _points(context: Context, prim: Prim, placement: Placement) -> list[Shape]:
    """One sphere for each point."""
    points, widths = prim.numbers("points", None), prim.numbers("widths", None)
    if points is None or widths is None or not len(points):
        return []
    centres = points.reshape(-1, 3)
    radii = np.broadcast_to(widths / 2, len(centres))
    return [
        dataclasses.replace(_ball(float(radius), placement), pose=Pose(placement.point(centre)))
        for centre, radius in zip(centres, radii, strict=True)
    ]


def _capsule(context: Context, prim: Prim, placement: Placement) -> list[Shape]:
    radius, height = _length(prim, "radius", 0.5), _length(prim, "height", 1.0)
    if placement.shears:
        solid = solids.round_cone(radius, radius, height)
        return [_tessellated(context, prim, solid, placement)]
    axis, scale = _axis(prim), np.abs(placement.scale)
    radial = float(np.delete(scale, axis).max())
    if np.ptp(scale) > _EQUAL * scale.max() and radius > 0:
        context.warn(
            "a capsule that is not scaled evenly stays a capsule with the larger radius, as "
            "UsdPhysics has it",
            prim.path,
        )
    size = np.array([radius * radial, height / 2 * scale[axis], 0])
    return [Shape(_GEOM.mjGEOM_CAPSULE, size, Pose(quat=aligning_z(np.eye(3)[axis])))]


def _cylinder(context: Context, prim: Prim, placement: Placement) -> list[Shape]:
    radius, height = _length(prim, "radius", 1.0), _length(prim, "height", 2.0)
    axis, scale = _axis(prim), np.abs(placement.scale)
    across = np.delete(scale, axis)
    if placement.shears or np.ptp(across) > _EQUAL * across.max():
        solid = solids.revolved([(-height / 2, radius), (height / 2, radius)])
        return [_tessellated(context, prim, solid, placement)]
    size = np.array([radius * across[0], height / 2 * scale[axis], 0])
    return [Shape(_GEOM.mjGEOM_CYLINDER, size, Pose(quat=aligning_z(np.eye(3)[axis])))]


def _cone(context: Context, prim: Prim, placement: Placement) -> list[Shape]:
    radius, height = _length(prim, "radius", 1.0), _length(prim, "height", 2.0)
    solid = solids.revolved([(-height / 2, radius), (height / 2, 0.0)])
    return [_tessellated(context, prim, solid, placement)]


def _two_radii(prim: Prim, otherwise: float) -> tuple[float, float]:
    return _length(prim, "radiusBottom", otherwise), _length(prim, "radiusTop", otherwise)


def _capsule_1(context: Context, prim: Prim, placement: Placement) -> list[Shape]:
    low, high = _two_radii(prim, 0.5)
    solid = solids.round_cone(low, high, _length(prim, "height", 1.0))
    return [_tessellated(context, prim, solid, placement)]


def _cylinder_1(context: Context, prim: Prim, placement: Placement) -> list[Shape]:
    low, high = _two_radii(prim, 1.0)
    height = _length(prim, "height", 2.0)
    solid = solids.revolved([(-height / 2, low), (height / 2, high)])
    return [_tessellated(context, prim, solid, placement)]


def _tessellated(context: Context, prim: Prim, solid: Solid, placement: Placement) -> Shape:
    """A solid of revolution along the prim's axis, as a convex mesh."""
    context.warn(f"a {prim.flat.type_name} becomes a convex mesh with 64 sides", prim.path)
    turned = Solid(solid.points @ _turned(_axis(prim)).T, solid.triangles)
    return Shape.mesh(turned.stretched(placement.stretch))


def _plane(context: Context, prim: Prim, placement: Placement) -> list[Shape]:
    """Infinite for collisions; its width and length are for the eye.

    The frame's x axis runs along the width and its y axis along the length: for a plane that
    faces z these are x and y, facing x they are z and y, facing y they are x and z.
    """
    width, length = _length(prim, "width", 2.0), _length(prim, "length", 2.0)
    facing = _axis(prim)
    along, across = {0: (2, 1), 1: (0, 2), 2: (0, 1)}[facing]
    normal = placement.stretch[:, facing]
    normal = normal / np.linalg.norm(normal) if normal.any() else np.eye(3)[facing]
    scale = np.abs(placement.scale)
    size = np.array([width / 2 * scale[along], length / 2 * scale[across], 1.0])
    if facing == 2 and normal[2] > 0 and math.isclose(normal[2], 1.0):
        return [Shape(_GEOM.mjGEOM_PLANE, size)]
    first = np.eye(3)[along] - normal * normal[along]
    first /= np.linalg.norm(first)
    rotation = np.stack([first, np.cross(normal, first), normal], axis=1)
    return [Shape(_GEOM.mjGEOM_PLANE, size, Pose(quat=quat_of(rotation)))]


_BUILDERS: dict[str, Build] = {
    "Cube": _cube,
    "Sphere": _sphere,
    "Points": _points,
    "Capsule": _capsule,
    "Capsule_1": _capsule_1,
    "Cylinder": _cylinder,
    "Cylinder_1": _cylinder_1,
    "Cone": _cone,
    "Plane": _plane,
}
