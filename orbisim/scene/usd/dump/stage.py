"""An open stage as a `FlatStage`."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from pxr import (  # type: ignore[import-untyped,unused-ignore]
    Usd,
    UsdGeom,
    UsdPhysics,
    UsdShade,
)

from orbisim.errors import SceneError
from orbisim.scene.usd.dump.geometry import MeshPool
from orbisim.scene.usd.dump.looks import LookPool
from orbisim.scene.usd.dump.values import to_value
from orbisim.scene.usd.dump.xforms import TIME, local_matrix
from orbisim.scene.usd.flat import FlatPrim, FlatStage, FloatArray, Note, Value

_SKIPPED = (
    "primvars:",
    "xformOp", "inputs:", "outputs:", "info:", "ui:", "extent", "userProperties:", "collection:",
    "normals", "velocities", "accelerations", "faceVertex", "points", "holeIndices", "crease",
    "corner", "subdivisionScheme", "orientation", "interpolateBoundary", "faceVarying",
    "triangleSubdivision", "doubleSided", "material:binding", "visibility", "purpose",
)  # fmt: skip
"""Attributes by the beginning of their name that are handled elsewhere or only for the eye."""

_KEPT = ("primvars:displayColor", "primvars:displayOpacity", "inputs:color")
_POINTS = ("points", "widths")


@dataclasses.dataclass(frozen=True)
class _Place:
    """What a prim inherits from its parent."""

    matrix: FloatArray
    visible: bool
    purpose: str


class StageDumper:
    """Walks a stage; use once."""

    def __init__(self, stage: Any, source: str) -> None:
        self._stage = stage
        self._source = source
        self._meshes = MeshPool(source)
        self._looks = LookPool()
        self._places = {"/": _Place(np.eye(4), True, "default")}
        self._prims: list[FlatPrim] = []
        self._notes: list[Note] = []

    def dump(self) -> FlatStage:
        """The stage in plain numbers.

        Raises:
          SceneError: a mesh or a transform is broken.
        """
        walk = iter(
            Usd.PrimRange(
                self._stage.GetPseudoRoot(), Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
            )
        )
        next(walk)  # the pseudo-root
        for prim in walk:
            if self._prune(prim):
                walk.PruneChildren()
            if not prim.IsA(UsdGeom.Subset):
                self._prims.append(self._dump_prim(prim))
        self._add_collision_groups()
        default = self._stage.GetDefaultPrim()
        return FlatStage(
            prims=tuple(self._prims),
            meshes=tuple(self._meshes.meshes),
            looks=tuple(self._looks.looks),
            name=(default.GetDisplayName() or default.GetName()) if default else "",
            meters_per_unit=self._metadata("metersPerUnit"),
            kilograms_per_unit=self._metadata("kilogramsPerUnit"),
            up_axis=str(UsdGeom.GetStageUpAxis(self._stage))
            if self._stage.HasAuthoredMetadata("upAxis")
            else "",
            notes=tuple(self._notes),
        )

    def _metadata(self, name: str) -> float | None:
        if not self._stage.HasAuthoredMetadata(name):
            return None
        return float(self._stage.GetMetadata(name))

    def _prune(self, prim: Any) -> bool:
        """Whether what lies below a prim is left out."""
        if prim.IsA(UsdGeom.PointInstancer):
            self._notes.append(
                Note(str(prim.GetPath()), "PointInstancer", "its instances are left out")
            )
            return True
        return bool(prim.IsA(UsdShade.Material) or prim.IsA(UsdShade.NodeGraph))

    def _dump_prim(self, prim: Any) -> FlatPrim:
        path = str(prim.GetPath())
        parent = self._places[str(prim.GetPath().GetParentPath())]
        local, resets = local_matrix(prim)
        matrix = local if resets else parent.matrix @ local
        if not np.isfinite(matrix).all():
            raise SceneError(
                self._source,
                "its transform is not finite",
                element=path,
                remedy="replace the NaN or infinite number in its xformOps",
            )
        place = _Place(matrix, parent.visible and _is_visible(prim), _purpose(prim, parent))
        self._places[path] = place
        attributes, animated, omitted = _attributes(prim)
        gprim = prim.IsA(UsdGeom.Gprim)
        return FlatPrim(
            path=path,
            type_name=str(prim.GetTypeName()),
            schemas=_schemas(prim),
            display_name=prim.GetDisplayName() or "",
            matrix=matrix,
            local=local,
            resets=resets,
            visible=place.visible,
            purpose=place.purpose,
            attributes=attributes,
            relationships=_relationships(prim),
            animated=animated,
            mesh=self._meshes.add(prim) if prim.IsA(UsdGeom.Mesh) else -1,
            physics_material=_physics_material(prim) if gprim else "",
            look=self._looks.add(prim) if gprim else -1,
            omitted=omitted,
        )

    def _add_collision_groups(self) -> None:
        """Writes each collision group's members into its relationships."""
        colliders = [prim.path for prim in self._prims if prim.has("PhysicsCollisionAPI")]
        for index, flat in enumerate(self._prims):
            if flat.type_name != "PhysicsCollisionGroup":
                continue
            group = UsdPhysics.CollisionGroup.Get(self._stage, flat.path)
            query = group.GetCollidersCollectionAPI().ComputeMembershipQuery()
            members = tuple(path for path in colliders if query.IsPathIncluded(path))
            relationships = {**flat.relationships, "colliders": members}
            self._prims[index] = dataclasses.replace(flat, relationships=relationships)


def _schemas(prim: Any) -> tuple[str, ...]:
    """Applied API schemas as authored, also those that OpenUSD does not know."""
    known = [str(name) for name in prim.GetAppliedSchemas()]
    listed = prim.GetMetadata("apiSchemas")
    authored = [str(name) for name in listed.GetAppliedItems()] if listed else []
    return tuple(dict.fromkeys([*authored, *known]))


def _is_visible(prim: Any) -> bool:
    attribute = UsdGeom.Imageable(prim).GetVisibilityAttr()
    return not attribute or attribute.Get(TIME) != UsdGeom.Tokens.invisible


def _purpose(prim: Any, parent: _Place) -> str:
    attribute = UsdGeom.Imageable(prim).GetPurposeAttr()
    if attribute and attribute.HasAuthoredValue():
        return str(attribute.Get())
    return parent.purpose


def _attributes(prim: Any) -> tuple[dict[str, Value], tuple[str, ...], tuple[str, ...]]:
    """Values by name, names of the animated ones, names of those that cannot be handed over."""
    values: dict[str, Value] = {}
    animated, omitted = [], []
    points = prim.IsA(UsdGeom.Points)
    for attribute in prim.GetAuthoredAttributes():
        name = attribute.GetName()
        if _is_skipped(name) and not (points and name in _POINTS):
            continue
        value = attribute.Get(TIME)
        if value is None:
            continue
        plain = to_value(value, str(attribute.GetTypeName()))
        if plain is None:
            omitted.append(name)
            continue
        values[name] = plain
        if attribute.GetNumTimeSamples() > 1:
            animated.append(name)
    return values, tuple(animated), tuple(omitted)


def _is_skipped(name: str) -> bool:
    return name.startswith(_SKIPPED) and name not in _KEPT


def _relationships(prim: Any) -> dict[str, tuple[str, ...]]:
    return {
        relationship.GetName(): tuple(str(path) for path in relationship.GetForwardedTargets())
        for relationship in prim.GetAuthoredRelationships()
        if not _is_skipped(relationship.GetName())
    }


def _physics_material(prim: Any) -> str:
    material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0]
    if not material or not material.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
        return ""
    return str(material.GetPath())
