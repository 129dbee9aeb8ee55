"""The geometry of every geom type, in MuJoCo's frame of the geom.

three.js puts the axis of cylinders along y and MuJoCo along z; `Shape.matrix` turns one into the
other, and scales a unit sphere to an ellipsoid.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.view import meshes
from orbisim.view.mapping import Mapping, face_uv
from orbisim.view.parts import Part
from orbisim.view.three import DOUBLE, FRONT, Json, buffers

Array = npt.NDArray[np.float64]
_G = mujoco.mjtGeom

_Y_TO_Z = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
_AROUND, _ALONG = 40, 24
"""Segments of round shapes around their axis and from pole to pole."""

_REACH = 15.0
"""Radius of an infinite plane as drawn, in units of the model's extent."""


@dataclasses.dataclass(frozen=True, eq=False)
class Shape:
    """A geometry of three.js and how to put it into the geom's frame.

    Attributes:
      geometry: in JSON form.
      matrix: [4, 4], from three.js's frame to the geom's.
      side: which faces to draw.
      mapped: whether it has texture coordinates.
      fades: whether vertex colours make it fade out towards its edge.
      flat: whether facets are seen.
    """

    geometry: Json
    matrix: Array = dataclasses.field(default_factory=lambda: np.eye(4))
    side: int = FRONT
    mapped: bool = False
    fades: bool = False
    flat: bool = False


def shape_of(
    model: mujoco.MjModel, part: Part, mapping: Mapping | None, max_faces: int | None = None
) -> Shape:
    """The shape of a geom or site.

    Args:
      mapping: of the 2D texture of its material, if it has one.
      max_faces: meshes with more triangles are simplified.
    """
    if part.kind in (_G.mjGEOM_MESH, _G.mjGEOM_SDF):
        mesh = meshes.mesh_of(model, part.data_id, mapping, max_faces)
        return Shape(mesh.geometry, side=DOUBLE, mapped=mesh.mapped)
    if part.kind == _G.mjGEOM_HFIELD:
        return Shape(
            meshes.height_field(model, part.data_id, mapping),
            side=DOUBLE,
            mapped=mapping is not None,
            flat=True,
        )
    if part.kind == _G.mjGEOM_PLANE:
        return _plane(part.size, mapping, _REACH * float(model.stat.extent))
    if part.kind == _G.mjGEOM_BOX and mapping is not None:
        return _textured_box(part.size, mapping)
    return _PRIMITIVES[part.kind](part.size)


def _sphere(size: Array) -> Shape:
    return _ellipsoid(np.repeat(size[:1], 3))


def _ellipsoid(size: Array) -> Shape:
    geometry = {
        "type": "SphereGeometry",
        "radius": 1.0,
        "widthSegments": _AROUND,
        "heightSegments": _ALONG,
    }
    return Shape(geometry, _Y_TO_Z @ np.diag([size[0], size[2], size[1], 1.0]))


def _cylinder(size: Array) -> Shape:
    geometry = {
        "type": "CylinderGeometry",
        "radiusTop": float(size[0]),
        "radiusBottom": float(size[0]),
        "height": 2 * float(size[1]),
        "radialSegments": _AROUND,
    }
    return Shape(geometry, _Y_TO_Z)


def _capsule(size: Array) -> Shape:
    """A profile turned around the axis: this release of three.js has no capsules."""
    radius, half = float(size[0]), float(size[1])
    angles = np.linspace(-np.pi / 2, np.pi / 2, _ALONG + 1)
    heights = radius * np.sin(angles)
    middle = _ALONG // 2
    profile = [
        *zip(radius * np.cos(angles[: middle + 1]), heights[: middle + 1] - half, strict=True),
        *zip(radius * np.cos(angles[middle:]), heights[middle:] + half, strict=True),
    ]
    points = [{"x": max(float(x), 0.0), "y": float(y)} for x, y in profile]
    return Shape({"type": "LatheGeometry", "points": points, "segments": _AROUND}, _Y_TO_Z)


def _box(size: Array) -> Shape:
    width, height, depth = (2 * float(s) for s in size)
    return Shape({"type": "BoxGeometry", "width": width, "height": height, "depth": depth})


_PRIMITIVES: dict[int, Callable[[Array], Shape]] = {
    int(_G.mjGEOM_SPHERE): _sphere,
    int(_G.mjGEOM_ELLIPSOID): _ellipsoid,
    int(_G.mjGEOM_CYLINDER): _cylinder,
    int(_G.mjGEOM_CAPSULE): _capsule,
    int(_G.mjGEOM_BOX): _box,
}


def _textured_box(size: Array, mapping: Mapping) -> Shape:
    """A box with the texture on every face; on opposite faces it is mirrored, as in MuJoCo."""
    import trimesh

    box = trimesh.creation.box(extents=2 * np.asarray(size))
    corners = np.asarray(box.vertices[box.faces]).reshape(-1, 3)
    normals = np.repeat(np.round(box.face_normals), 3, axis=0)
    axis = np.abs(normals).argmax(axis=1)
    along = np.array([[1, 2], [0, 2], [0, 1]])[axis]
    uv = mapping.stretched(face_uv(np.take_along_axis(corners / size, along, axis=1)))
    return Shape(buffers(corners, normal=normals, uv=uv), mapped=True)


def _plane(size: Array, mapping: Mapping | None, reach: float) -> Shape:
    if size[0] <= 0 and size[1] <= 0:
        return disc(reach, mapping.projected if mapping else None)
    x, y = (float(s) if s > 0 else reach for s in size[:2])
    ends = np.array([[-1.0, -1.0], [1, -1], [1, 1], [-1, 1]])
    corners = np.column_stack([ends * [x, y], np.zeros(4)])
    uv = None
    if mapping is not None:
        finite = size[0] > 0 and size[1] > 0
        uv = mapping.stretched(face_uv(ends)) if finite else mapping.projected(corners)
    normal = np.tile([0.0, 0.0, 1.0], (4, 1))
    geometry = buffers(corners, [[0, 1, 2], [0, 2, 3]], normal=normal, uv=uv)
    return Shape(geometry, side=DOUBLE, mapped=mapping is not None)


def disc(radius: float, uv_of: Callable[[Array], Array] | None) -> Shape:
    """A horizontal disc whose outer part fades out: an infinite plane, as far as it is drawn."""
    radii = np.array([0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0])
    alpha = np.interp(radii, [0.3, 1.0], [1.0, 0.0])
    angle = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(_AROUND)], axis=1)
    position = radius * (radii[:, None, None] * ring).reshape(-1, 3)
    near = np.arange(_AROUND)
    far = np.roll(near, -1)
    quads = np.stack([near, near + _AROUND, far + _AROUND, near, far + _AROUND, far], axis=1)
    index = (quads[None] + _AROUND * np.arange(len(radii) - 1)[:, None, None]).reshape(-1, 3)
    color = np.ones((len(position), 4))
    color[:, 3] = np.repeat(alpha, _AROUND)
    normal = np.tile([0.0, 0.0, 1.0], (len(position), 1))
    uv = uv_of(position) if uv_of else None
    geometry = buffers(position, index, normal=normal, uv=uv, color=color)
    return Shape(geometry, side=DOUBLE, mapped=uv is not None, fades=True)
