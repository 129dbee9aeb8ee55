"""Mesh prims as colliders, by their collision approximation, and as things to look at."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from orbisim.scene.usd import solids
from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.pose import Pose, quat_of
from orbisim.scene.usd.shapes import Shape
from orbisim.scene.usd.solids import Solid

_FLAT = 1e-5
"""Thickness over size of a mesh below which Qhull finds no volume in float32 coordinates."""
_CONVEX = 1e-3  # relative difference between a mesh's volume and its hull's
_GEOM = mujoco.mjtGeom

Approximate = Callable[[Context, Prim, Solid], list[Shape]]


def solid_of(context: Context, prim: Prim) -> Solid | None:
    """A mesh prim's geometry relative to its frame, in m; None if it is empty."""
    if prim.flat.mesh < 0:
        return None
    mesh = context.stage.meshes[prim.flat.mesh]
    points = np.asarray(mesh.points, np.float64)
    return Solid(points, mesh.triangles).stretched(context.place(prim.path).stretch).trimmed()


def visual_shapes(context: Context, prim: Prim) -> list[Shape]:
    """A mesh to look at."""
    solid = solid_of(context, prim)
    if solid is None:
        context.omit(prim.path, "a mesh without faces", "left out")
        return []
    return [Shape.mesh(solid)]


def collision_shapes(context: Context, prim: Prim) -> list[Shape]:
    """A mesh as colliders.

    Raises:
      SceneError: it has no faces.
    """
    solid = solid_of(context, prim)
    if solid is None:
        raise prim.error("collides but has no faces", "give it faces or remove its CollisionAPI")
    name = prim.token("physics:approximation", "none")
    approximate = _APPROXIMATIONS.get(name, _hull_instead(f"physics:approximation {name!r}"))
    if solid.flatness() < _FLAT:
        solid = _thickened(context, prim, solid)
    return approximate(context, prim, solid)


def _thickened(context: Context, prim: Prim, solid: Solid) -> Solid:
    size = float(np.ptp(solid.points, axis=0).max())
    thickness = 0.01 * size
    thick = solids.slab(solid, thickness)
    if size == 0 or thick is solid:
        raise prim.error("collides but has no extent", "remove its CollisionAPI")
    context.warn(
        f"a flat mesh collides as a slab of {thickness:.3g} m below its surface", prim.path
    )
    return thick


def _hull(context: Context, prim: Prim, solid: Solid) -> list[Shape]:
    return [Shape.mesh(solid)]


def _as_it_is(context: Context, prim: Prim, solid: Solid) -> list[Shape]:
    """MuJoCo collides meshes as their convex hulls."""
    exact = solid.is_closed() and solid.volume > 0
    if _is_convex(solid):
        return [Shape.mesh(solid, exact_inertia=exact)]
    if context.decompose:
        return _decomposition(context, prim, solid)
    context.omit(
        prim.path,
        f"physics:approximation {prim.token('physics:approximation', 'none')!r} of a mesh that "
        "is not convex",
        "collides as its convex hull; decompose=True splits it into convex parts",
    )
    return [Shape.mesh(solid, exact_inertia=exact)]


def _hull_instead(feature: str) -> Approximate:
    def approximate(context: Context, prim: Prim, solid: Solid) -> list[Shape]:
        context.omit(prim.path, feature, "collides as its convex hull")
        return [Shape.mesh(solid)]

    return approximate


def _decomposition(context: Context, prim: Prim, solid: Solid) -> list[Shape]:
    """Convex parts found by V-HACD; the hull if that is not installed."""
    import trimesh

    if _is_convex(solid):
        return [Shape.mesh(solid)]
    limit = prim.number("physxConvexDecompositionCollision:maxConvexHulls")
    options = {"maxConvexHulls": int(limit or 32), "resolution": 100_000}
    mesh = trimesh.Trimesh(solid.points, solid.triangles, process=True)
    try:
        parts = trimesh.decomposition.convex_decomposition(mesh, **options)
    except ImportError:
        context.omit(
            prim.path,
            "physics:approximation 'convexDecomposition'",
            "collides as its convex hull; install the package vhacdx to split it",
        )
        return [Shape.mesh(solid)]
    pieces = [
        Solid(np.asarray(part["vertices"], np.float64), np.asarray(part["faces"], np.int32))
        for part in parts
    ]
    kept = [piece.trimmed() for piece in pieces if piece.flatness() > _FLAT]
    return [Shape.mesh(piece) for piece in kept] or [Shape.mesh(solid)]


def _bounding_box(context: Context, prim: Prim, solid: Solid) -> list[Shape]:
    """The smallest box around the mesh; aligned with the prim's axes if that is as small."""
    low, high = solid.points.min(axis=0), solid.points.max(axis=0)
    aligned = Shape(_GEOM.mjGEOM_BOX, (high - low) / 2, Pose((high + low) / 2))
    import trimesh

    try:
        to_box, extents = trimesh.bounds.oriented_bounds(solid.points)
    except (ValueError, RuntimeError):
        return [aligned]
    if np.prod(extents) > 0.99 * np.prod(high - low):
        return [aligned]
    rotation = np.asarray(to_box[:3, :3]).T
    centre = -rotation @ to_box[:3, 3]
    return [Shape(_GEOM.mjGEOM_BOX, np.asarray(extents) / 2, Pose(centre, quat_of(rotation)))]


def _bounding_sphere(context: Context, prim: Prim, solid: Solid) -> list[Shape]:
    """The smallest sphere around the mesh (Badoiu and Clarkson, 2003, then tightened)."""
    centre = (solid.points.min(axis=0) + solid.points.max(axis=0)) / 2
    best, radius = centre, float(np.linalg.norm(solid.points - centre, axis=1).max())
    for step in range(1, 1001):
        distance = np.linalg.norm(solid.points - centre, axis=1)
        farthest = int(distance.argmax())
        if distance[farthest] < radius:
            best, radius = centre, float(distance[farthest])
        centre = centre + (solid.points[farthest] - centre) / (step + 1)
    return [Shape(_GEOM.mjGEOM_SPHERE, np.array([radius, 0, 0]), Pose(best))]


def _is_convex(solid: Solid) -> bool:
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(solid.points)
    except (QhullError, ValueError):
        return False
    return bool(abs(abs(solid.volume) - hull.volume) <= _CONVEX * hull.volume)


_APPROXIMATIONS: dict[str, Approximate] = {
    "none": _as_it_is,
    "meshSimplification": _as_it_is,
    "sdf": _as_it_is,
    "convexHull": _hull,
    "convexDecomposition": _decomposition,
    "boundingCube": _bounding_box,
    "boundingSphere": _bounding_sphere,
}
