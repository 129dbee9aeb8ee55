"""Visual and collision elements as geoms."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from orbisim.errors import SceneError
from orbisim.scene.reading import Unsupported
from orbisim.scene.urdf.assembly import Member
from orbisim.scene.urdf.assets import Meshes
from orbisim.scene.urdf.model import Array, Rgba, Shape

VISUAL_GROUP = 1
"""As in MuJoCo's import."""

COLLISION_GROUP = 0
"""Of links that have no visual geometry."""

HIDDEN_GROUP = 3
"""Of the collision geometry of links that also have visual geometry; viewers hide this group."""

_TYPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
}


class Geoms:
    """Adds the geoms of links to bodies."""

    def __init__(self, meshes: Meshes, source: str, *, visuals: bool) -> None:
        self._meshes, self._source, self._visuals = meshes, source, visuals
        self._names: set[str] = set()
        self._unnamed = 0
        self._textured: list[str] = []
        self._missing: list[Unsupported] = []

    def add(self, body: mujoco.MjsBody, member: Member) -> None:
        """Adds the collision and visual geometry of one link.

        Raises:
          SceneError: a size is not positive, or a mesh file is missing or broken.
        """
        link = member.link
        drawn = link.visuals if self._visuals else ()
        color = next((v.rgba for v in reversed(link.visuals) if v.rgba is not None), None)
        for shape in link.collisions:
            geom = self._geom(body, member, shape)
            geom.group = HIDDEN_GROUP if drawn else COLLISION_GROUP
            if color is not None:
                geom.rgba = color
            if shape.kind == "mesh":
                geom.meshname = self._meshes.collision(shape)
        for shape in drawn:
            self._add_visual(body, member, shape)

    def _add_visual(self, body: mujoco.MjsBody, member: Member, shape: Shape) -> None:
        if _degenerate(shape):
            self._missing.append(
                Unsupported(shape.label, f"a {shape.kind} without extent", "it is not drawn")
            )
            return
        if shape.textured:
            self._textured.append(shape.label)
        pieces: Sequence[tuple[str | None, Rgba | None]] = [(None, None)]
        if shape.kind == "mesh":
            pieces = self._meshes.visual(shape)
        for mesh, own_color in pieces:
            geom = self._geom(body, member, shape)
            geom.contype = geom.conaffinity = 0
            geom.group, geom.density = VISUAL_GROUP, 0.0
            if mesh is not None:
                geom.meshname = mesh
            color = shape.rgba or own_color
            if color is not None:
                geom.rgba = color

    def _geom(self, body: mujoco.MjsBody, member: Member, shape: Shape) -> mujoco.MjsGeom:
        self._check(shape)
        geom = body.add_geom(
            pos=member.pos + member.rotation @ shape.pos,
            quat=quaternion(member.rotation @ shape.rotation),
        )
        if shape.kind == "mesh":
            geom.type = mujoco.mjtGeom.mjGEOM_MESH
        else:
            geom.type = _TYPES[shape.kind]
            size = _half_sizes(shape)
            geom.size[: len(size)] = size
        if shape.name and shape.name not in self._names:
            geom.name = shape.name
            self._names.add(shape.name)
        elif shape.name:
            self._unnamed += 1
        return geom

    def _check(self, shape: Shape) -> None:
        problem = _degenerate(shape)
        if problem:
            raise SceneError(
                self._source, problem, element=shape.label, remedy="give positive sizes in metres"
            )

    def warnings(self) -> list[str]:
        """What had to be assumed."""
        found = list(self._meshes.notes)
        if self._unnamed:
            found.append(
                f"{self._unnamed} geoms have no name: theirs is taken by another visual or "
                "collision element"
            )
        return found

    def unsupported(self) -> list[Unsupported]:
        """Textures, which are not carried, and shapes that cannot be drawn."""
        found = list(self._missing)
        if self._textured:
            more = f" and {len(self._textured) - 1} more" if len(self._textured) > 1 else ""
            found.append(Unsupported(self._textured[0] + more, "<texture>", "plain colour"))
        if self._meshes.textured:
            names = list(self._meshes.textured)
            more = f" and {len(names) - 1} more" if len(names) > 1 else ""
            found.append(Unsupported(f"mesh {names[0]!r}{more}", "texture images", "plain colours"))
        return found


def quaternion(rotation: Array) -> Array:
    """(w, x, y, z) of a rotation matrix."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(rotation, np.float64).ravel())
    return quat


def _degenerate(shape: Shape) -> str | None:
    """What is wrong with a shape's size; None if nothing is."""
    if any(size <= 0 for size in shape.size):
        return f"its {shape.kind} has a size that is not positive: {shape.size}"
    if any(factor == 0 for factor in shape.scale):
        return f"its mesh has a scale of zero: {shape.scale}"
    return None


def _half_sizes(shape: Shape) -> tuple[float, ...]:
    """URDF gives edges and lengths, MuJoCo takes halves of them; radii stay."""
    if shape.kind == "box":
        return tuple(edge / 2 for edge in shape.size)
    radius, *length = shape.size
    return (radius, *(value / 2 for value in length))
