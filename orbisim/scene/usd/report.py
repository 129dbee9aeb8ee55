"""What the reader knows it does not carry, by type of prim and by schema."""

from __future__ import annotations

from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.joints import JOINT_TYPES

_HANDLED_TYPES = {
    "", "Xform", "Scope", "Material", "NodeGraph", "Shader", "Camera", "PhysicsScene",
    "PhysicsCollisionGroup", "MjcActuator", "MjcTendon", "MjcKeyframe", "NewtonActuator",
    "Mesh", "Cube", "Sphere", "Capsule", "Capsule_1", "Cylinder", "Cylinder_1", "Cone", "Plane",
    "PointInstancer", "DistantLight", "SphereLight", "DomeLight", "DomeLight_1", "RectLight",
    "DiskLight", "CylinderLight", "GeometryLight", "PortalLight", "GeomSubset", *JOINT_TYPES,
}  # fmt: skip
"""Types that some module reads, lists as unsupported itself, or that hold nothing to carry."""

_IRRELEVANT_TYPES = ("Render", "Skel", "Preliminary", "GenerativeProcedural", "Backdrop")
_HANDLED_SCHEMAS = {
    "PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsMeshCollisionAPI", "PhysicsMassAPI",
    "PhysicsMaterialAPI", "PhysicsArticulationRootAPI", "PhysicsFilteredPairsAPI",
    "PhysicsDriveAPI", "PhysicsLimitAPI",
    "MjcSceneAPI", "MjcSiteAPI", "MjcImageableAPI", "MjcCollisionAPI", "MjcMeshCollisionAPI",
    "MjcJointAPI", "MjcMaterialAPI", "MjcEqualityAPI", "MjcEqualityConnectAPI",
    "MjcEqualityWeldAPI", "MjcEqualityJointAPI",
    "NewtonSceneAPI", "NewtonArticulationRootAPI", "NewtonJointAPI", "NewtonMassAPI",
    "NewtonCollisionAPI", "NewtonMeshCollisionAPI", "NewtonSiteAPI", "NewtonMaterialAPI",
    "NewtonMimicAPI", "NewtonPDControlAPI", "NewtonActuatorDelayAPI",
    "NewtonMaxEffortClampingAPI",
    "PhysxArticulationAPI", "PhysxJointAPI", "PhysxCollisionAPI", "PhysxRigidBodyAPI",
    "PhysxSceneAPI", "PhysxMaterialAPI", "PhysxMimicJointAPI", "PhysxConvexHullCollisionAPI",
    "PhysxConvexDecompositionCollisionAPI", "PhysxLimitAPI",
    "PhysxTendonAxisRootAPI", "PhysxTendonAxisAPI", "PhysxTendonAttachmentRootAPI",
    "PhysxTendonAttachmentAPI", "PhysxTendonAttachmentLeafAPI",
    "PhysicsJointStateAPI",
}  # fmt: skip
"""Schemas whose attributes are read or reported one by one."""

_PHYSICAL_PREFIXES = ("Physics", "Physx", "Mjc", "Newton", "Isaac", "Tensor")


def report(context: Context) -> None:
    """Lists prim types, schemas and attributes that nothing has taken care of."""
    for note in context.stage.notes:
        context.omit(note.element, note.feature, note.consequence)
    for prim in context.prims.values():
        if _is_left_out(prim):
            context.omit(prim.path, f"prims of type {prim.flat.type_name}", "left out")
        for schema in _unknown_schemas(prim):
            context.omit(prim.path, schema, "ignored")
        for name in prim.leftovers():
            context.omit(prim.path, name, "ignored")
        for name in prim.animated():
            context.omit(prim.path, f"time samples of {name}", "the first one holds")


def _is_left_out(prim: Prim) -> bool:
    kind = prim.flat.type_name
    if kind == "Points" and prim.has("PhysicsCollisionAPI"):
        return False
    return kind not in _HANDLED_TYPES and not kind.startswith(_IRRELEVANT_TYPES)


def _unknown_schemas(prim: Prim) -> list[str]:
    if prim.flat.type_name == "NewtonActuator":  # reported where it is read
        return []
    names = [schema.partition(":")[0] for schema in prim.flat.schemas]
    return [
        name
        for name in names
        if name.startswith(_PHYSICAL_PREFIXES) and name not in _HANDLED_SCHEMAS
    ]
