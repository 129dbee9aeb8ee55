"""Adds geoms, sites and mass properties to the bodies of a spec."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from orbisim.scene.usd import tables
from orbisim.scene.usd.assets import INERTIA, MaterialAssets, MeshAssets
from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.filters import Masks
from orbisim.scene.usd.geoms import Geometry
from orbisim.scene.usd.names import NameBook
from orbisim.scene.usd.pose import Pose
from orbisim.scene.usd.shapes import Shape
from orbisim.scene.usd.solids import Solid
from orbisim.scene.usd.tables import Field
from orbisim.scene.usd.units import WATER

_GEOM = mujoco.mjtGeom
_VISUAL_GROUP = 2
"""Where MuJoCo's models keep what is only looked at; viewers show it."""
_HIDDEN_GROUP = 3
"""Where MuJoCo's models keep collision geometry; viewers hide it."""
_THIN = 1e-4  # m, half thickness of a plane that moves, to look at

_FIELDS = (
    Field("mjc:condim", "condim", tables.integer),
    Field("mjc:priority", "priority", tables.integer),
    Field("mjc:solimp", "solimp", tables.vector),
    Field("mjc:solref", "solref", tables.vector),
    Field("mjc:solmix", "solmix", tables.number),
    Field("mjc:margin", "margin", tables.number),
    Field("mjc:gap", "gap", tables.number),
)
_MESH_INERTIA = {
    "legacy": INERTIA.mjMESH_INERTIA_LEGACY,
    "convex": INERTIA.mjMESH_INERTIA_CONVEX,
    "exact": INERTIA.mjMESH_INERTIA_EXACT,
    "shell": INERTIA.mjMESH_INERTIA_SHELL,
}
_HULL_LIMITS = (
    "mjc:maxhullvert", "newton:maxHullVertices", "physxConvexHullCollision:hullVertexLimit"
)  # fmt: skip


class GeomBuilder:
    """Turns geometry into geoms of one spec."""

    def __init__(
        self,
        context: Context,
        meshes: MeshAssets,
        materials: MaterialAssets,
        names: Mapping[str, str],
        masks: Mapping[str, Masks],
    ) -> None:
        self._context = context
        self._meshes = meshes
        self._materials = materials
        self._names = names
        self._masks = masks
        self._book = NameBook(names.values())

    def add(self, parent: mujoco.MjsBody, geometry: Geometry, *, static: bool) -> list[str]:
        """Adds a geometry's geoms to a body; returns their names."""
        added = []
        for index, shape in enumerate(geometry.shapes):
            drawable = self._drawable(geometry, shape, static)
            if drawable is None:
                continue
            name = self._names[geometry.path]
            name = name if index == 0 else self._book(f"{name}_{index}")
            self._add_one(parent, geometry, drawable, name)
            added.append(name)
        return added

    def _drawable(self, geometry: Geometry, shape: Shape, static: bool) -> Shape | None:
        """The shape, unless it is a plane that moves: MuJoCo's planes do not."""
        if shape.kind != _GEOM.mjGEOM_PLANE or static:
            return shape
        if geometry.collides:
            self._context.omit(geometry.path, "a Plane that collides on a moving body", "left out")
            return None
        flat = np.array([shape.size[0], shape.size[1], _THIN])
        return Shape(_GEOM.mjGEOM_BOX, flat, shape.pose)

    def _add_one(self, parent: mujoco.MjsBody, geometry: Geometry, shape: Shape, name: str) -> None:
        geom = parent.add_geom(name=name, type=shape.kind)
        pose = geometry.pose @ shape.pose
        geom.pos, geom.quat = pose.pos, pose.quat
        if shape.solid is not None:
            geom.meshname = self._mesh(geometry, shape, shape.solid)
        else:
            _check_size(geometry.prim, shape)
            geom.size = shape.size
        self._dress(geom, geometry)
        if geometry.collides:
            self._set_contact(geom, geometry)
            _set_mass(geom, geometry, shape)
        else:
            geom.contype = geom.conaffinity = 0
            geom.mass = 0

    def _mesh(self, geometry: Geometry, shape: Shape, solid: Solid) -> str:
        name = self._names[geometry.path]
        if not geometry.collides:
            return self._meshes.add(name, solid, INERTIA.mjMESH_INERTIA_SHELL)
        inertia = INERTIA.mjMESH_INERTIA_CONVEX
        if shape.exact_inertia:
            inertia = INERTIA.mjMESH_INERTIA_EXACT
        prim = geometry.prim
        if _is_shell(prim):
            inertia = INERTIA.mjMESH_INERTIA_SHELL
        if prim.authored("mjc:inertia"):
            inertia = _MESH_INERTIA[prim.choice("mjc:inertia", tuple(_MESH_INERTIA), "legacy")]
        limits = [prim.number(limit) for limit in _HULL_LIMITS]
        limit = next((int(value) for value in limits if value and value >= 4), -1)
        return self._meshes.add(name, solid, inertia, limit)

    def _dress(self, geom: mujoco.MjsGeom, geometry: Geometry) -> None:
        prim = geometry.prim
        geom.group = _group(prim, _VISUAL_GROUP if not geometry.collides else 0)
        colour = paint(prim)
        if prim.flat.look >= 0:
            geom.material = self._materials.add(self._context.stage.looks[prim.flat.look])
        elif colour is not None:
            geom.rgba = colour
        if prim.flat.mesh >= 0 and self._context.stage.meshes[prim.flat.mesh].subsets:
            self._context.omit(prim.path, "materials of GeomSubsets", "one material for the mesh")

    def _set_contact(self, geom: mujoco.MjsGeom, geometry: Geometry) -> None:
        prim, length = geometry.prim, self._context.units.length
        if geometry.surface.friction is not None:
            geom.friction = geometry.surface.friction
        if geometry.surface.solref is not None:
            geom.solref = [*geometry.surface.solref]
        _set_margin(prim, geom, length)
        tables.apply(_FIELDS, prim, geom)
        masks = self._masks.get(geometry.path)
        if masks is not None:
            geom.contype, geom.conaffinity = masks.contype, masks.conaffinity


def _set_margin(prim: Prim, geom: Any, length: float) -> None:
    """Distance at which a contact pushes, and how much farther away it is found."""
    rest = prim.number("physxCollision:restOffset", length, infinite=True)
    reach = prim.number("physxCollision:contactOffset", length, infinite=True)
    margin = prim.number("newton:contactMargin", length, infinite=True)
    gap = prim.number("newton:contactGap", length, infinite=True)
    if rest is not None and 0 <= rest < np.inf:
        geom.margin = rest
    if reach is not None and geom.margin <= reach < np.inf:
        geom.gap = reach - geom.margin
    if margin is not None and 0 <= margin < np.inf:
        geom.margin = margin
    if gap is not None and 0 <= gap < np.inf:
        geom.gap = gap


def _set_mass(geom: mujoco.MjsGeom, geometry: Geometry, shape: Shape) -> None:
    """Mass, shared by volume among several shapes, or density."""
    if _is_shell(geometry.prim) and shape.solid is None:
        geom.typeinertia = mujoco.mjtGeomInertia.mjINERTIA_SHELL
    if geometry.mass.mass is not None:
        geom.mass = geometry.mass.mass * share_of_volume(geometry, shape)
    else:
        geom.density = WATER if geometry.density is None else geometry.density


def share_of_volume(geometry: Geometry, shape: Shape) -> float:
    """A shape's part of the volume of all shapes of a geometry."""
    if len(geometry.shapes) == 1:
        return 1.0
    volumes = [_volume(other) for other in geometry.shapes]
    return _volume(shape) / sum(volumes)


def _volume(shape: Shape) -> float:
    if shape.solid is not None:
        return abs(shape.solid.volume)
    return float(np.prod(shape.size[shape.size > 0])) ** (3 / np.count_nonzero(shape.size))


def _is_shell(prim: Prim) -> bool:
    shell = prim.choice("newton:massModel", ("solid", "shell"), "solid") == "shell"
    return prim.flag("mjc:shellinertia", False) or shell


def _check_size(prim: Prim, shape: Shape) -> None:
    needed = {
        _GEOM.mjGEOM_SPHERE: 1, _GEOM.mjGEOM_CAPSULE: 2, _GEOM.mjGEOM_CYLINDER: 2,
        _GEOM.mjGEOM_BOX: 3, _GEOM.mjGEOM_ELLIPSOID: 3,
    }.get(shape.kind, 0)  # fmt: skip
    if not (shape.size[:needed] > 0).all():
        raise prim.error(
            f"its size comes to {shape.size[:needed].tolist()} m",
            "sizes and scales must not be zero",
        )


def _group(prim: Prim, otherwise: int) -> int:
    """MuJoCo's group: as authored, or one that viewers hide or show like USD's would."""
    if prim.authored("mjc:group"):
        return tables.integer(prim, "mjc:group") or 0
    if any(schema.startswith("Mjc") for schema in prim.flat.schemas):
        return 0
    hidden = not prim.flat.visible or prim.flat.purpose in ("proxy", "guide")
    return _HIDDEN_GROUP if hidden else otherwise


def paint(prim: Prim) -> list[float] | None:
    """Red, green, blue and opacity from the display colour, or None."""
    colour = prim.numbers("primvars:displayColor", None)
    opacity = prim.numbers("primvars:displayOpacity", None)
    if (colour is None or len(colour) < 3) and (opacity is None or not len(opacity)):
        return None
    rgb = [0.5, 0.5, 0.5] if colour is None or len(colour) < 3 else colour[:3].tolist()
    alpha = 1.0 if opacity is None or not len(opacity) else float(opacity[0])
    return [min(max(component, 0.0), 1.0) for component in (*rgb, alpha)]


def add_site(
    context: Context, parent: mujoco.MjsBody, prim: Prim, shapes: Sequence[Shape], pose: Pose,
    name: str,
) -> None:  # fmt: skip
    """Adds a prim that marks a frame."""
    shape = shapes[0] if shapes else Shape(_GEOM.mjGEOM_SPHERE, np.array([0.01, 0, 0]))
    if shape.solid is not None or shape.kind == _GEOM.mjGEOM_PLANE:
        shape = Shape(_GEOM.mjGEOM_SPHERE, np.array([0.01, 0, 0]))
    full = pose @ shape.pose
    site = parent.add_site(name=name, type=shape.kind, pos=full.pos, quat=full.quat)
    site.size = np.where(shape.size > 0, shape.size, site.size)
    site.group = _group(prim, 0)
    colour = paint(prim)
    if colour is not None:
        site.rgba = colour
