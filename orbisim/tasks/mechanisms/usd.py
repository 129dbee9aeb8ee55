"""Writes a mechanism as USD: UsdPhysics, and MuJoCo's attributes for what it lacks."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from orbisim.files.writing import make_folder, write_text
from orbisim.tasks.mechanisms.model import BASE, Floats, Joint, Mechanism, Part
from orbisim.tasks.mechanisms.solids import Solid, mass_properties, surface

_HEAD = """#usda 1.0
(
    defaultPrim = "{name}"
    metersPerUnit = 1
    kilogramsPerUnit = 1
    upAxis = "Z"
)

def PhysicsScene "physics" (prepend apiSchemas = ["MjcSceneAPI"])
{{
    uniform token mjc:compiler:angle = "radian"
    double mjc:option:timestep = 0.002
}}
"""
_FLIPS: Mapping[str, tuple[int, ...]] = {"X": (0, 0, 0, 1), "Y": (0, 1, 0, 0), "Z": (0, 1, 0, 0)}
"""Quaternions of half a turn that reverse an axis."""


def write_usd(mechanism: Mechanism, folder: Path) -> Path:
    """Writes `NAME.usda` to a folder; returns its path.

    Lengths, angles and masses are float32 where UsdPhysics has them so: a trajectory is that of
    the URDF as far as that goes.

    Raises:
      OutputError: the folder cannot be written.
    """
    make_folder(folder)
    path = folder / f"{mechanism.name}.usda"
    write_text(path, "\n".join([_HEAD.format(name=mechanism.name), *_robot(mechanism)]) + "\n")
    return path


def _robot(mechanism: Mechanism) -> Iterable[str]:
    effects = json.dumps([effect.to_json() for effect in mechanism.effects])
    places = _places(mechanism)
    schemas = '"PhysicsArticulationRootAPI", "MaterialBindingAPI"'
    yield f'def Xform "{mechanism.name}" (prepend apiSchemas = [{schemas}])'
    yield "{"
    yield f"    rel material:binding:physics = </{mechanism.name}/surface>"
    yield '    def Material "surface" (prepend apiSchemas = ["PhysicsMaterialAPI"])'
    yield "    {"
    yield "        float physics:staticFriction = 1"
    yield "        float physics:dynamicFriction = 1"
    yield "    }"
    yield f"    custom string orbisim:effects = '{effects}'"
    for part in mechanism.parts:
        yield from _part(part, places[part.name])
    yield '    def Scope "joints"'
    yield "    {"
    for joint in mechanism.joints:
        yield from _joint(joint, f"/{mechanism.name}")
    yield "    }"
    yield '    def PhysicsCollisionGroup "apart" (prepend apiSchemas = ["CollectionAPI:colliders"])'
    yield "    {"
    yield f"        rel collection:colliders:includes = </{mechanism.name}>"
    yield f"        rel physics:filteredGroups = </{mechanism.name}/apart>"
    yield "    }"
    yield "}"


def _places(mechanism: Mechanism) -> dict[str, Floats]:
    """Where the frames of parts are with all joints at zero, m."""
    places = {BASE: np.zeros(3)}
    waiting = list(mechanism.joints)
    while waiting:
        joint = next(joint for joint in waiting if joint.parent in places)
        places[joint.child] = places[joint.parent] + np.array(joint.pos)
        waiting.remove(joint)
    return places


def _part(part: Part, place: Floats) -> Iterable[str]:
    moves = part.name != BASE
    schemas = '(prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"])' if moves else ""
    yield f'    def Xform "{part.name}" {schemas}'
    yield "    {"
    yield f"        double3 xformOp:translate = {_tuple(place)}"
    yield '        uniform token[] xformOpOrder = ["xformOp:translate"]'
    if moves:
        mass, com, tensor = mass_properties(part.solids, part.density)
        moments, axes = np.linalg.eigh(tensor)
        axes = axes * np.sign(np.linalg.det(axes))
        yield f"        float physics:mass = {mass!r}"
        yield f"        point3f physics:centerOfMass = {_tuple(com)}"
        yield f"        float3 physics:diagonalInertia = {_tuple(moments)}"
        yield f"        quatf physics:principalAxes = {_tuple(_quaternion(axes))}"
    yield from _mesh(f"{part.name}_visual", surface(part.solids), (), part)
    for number, solid in enumerate(part.solids):
        yield from _solid(f"{part.name}_{number}", solid)
    yield "    }"


def _solid(name: str, solid: Solid) -> Iterable[str]:
    if solid.kind == "frustum":
        yield from _mesh(name, solid.mesh(), ("PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"))
        return
    pose, box = solid.pose, solid.kind == "box"
    if box:
        pose = pose @ np.diag([*solid.size, 1.0])
    yield f'        def {"Cube" if box else "Cylinder"} "{name}" (prepend apiSchemas = ' + (
        '["PhysicsCollisionAPI"])'
    )
    yield "        {"
    if box:
        yield "            double size = 1"
    else:
        radius, length = solid.size
        yield f"            double radius = {float(radius)!r}"
        yield f"            double height = {float(length)!r}"
        yield '            uniform token axis = "Z"'
    rows = ", ".join(_tuple(row) for row in pose.T)  # USD multiplies from the left
    yield f"            matrix4d xformOp:transform = ({rows})"
    yield '            uniform token[] xformOpOrder = ["xformOp:transform"]'
    yield '            uniform token purpose = "guide"'
    yield "        }"


def _mesh(
    name: str, mesh: trimesh.Trimesh, schemas: tuple[str, ...], part: Part | None = None
) -> Iterable[str]:
    listed = ", ".join(f'"{schema}"' for schema in schemas)
    yield f'        def Mesh "{name}"' + (f" (prepend apiSchemas = [{listed}])" if schemas else "")
    yield "        {"
    yield f"            point3f[] points = [{', '.join(_tuple(p) for p in mesh.vertices)}]"
    yield f"            int[] faceVertexCounts = [{', '.join(['3'] * len(mesh.faces))}]"
    yield f"            int[] faceVertexIndices = [{', '.join(map(str, mesh.faces.ravel()))}]"
    yield '            uniform token subdivisionScheme = "none"'
    if part is not None:
        yield f"            color3f[] primvars:displayColor = [{_tuple(part.rgb)}]"
    if schemas:
        yield '            uniform token physics:approximation = "convexHull"'
        yield '            uniform token purpose = "guide"'
    yield "        }"


def _joint(joint: Joint, root: str) -> Iterable[str]:
    hinge = joint.kind == "hinge"
    at = int(np.argmax(np.abs(joint.axis)))
    axis = "XYZ"[at]
    turn = (1, 0, 0, 0) if joint.axis[at] > 0 else _FLIPS[axis]
    unit = 180 / np.pi if hinge else 1.0
    kind = "PhysicsRevoluteJoint" if hinge else "PhysicsPrismaticJoint"
    yield f'    def {kind} "{joint.name}" (prepend apiSchemas = ["MjcJointAPI"])'
    yield "    {"
    yield f'        uniform token physics:axis = "{axis}"'
    for side, part in enumerate((joint.parent, joint.child)):
        yield f"        rel physics:body{side} = <{root}/{part}>"
        pos = joint.pos if side == 0 else (0.0, 0.0, 0.0)
        yield f"        point3f physics:localPos{side} = {_tuple(pos)}"
        yield f"        quatf physics:localRot{side} = {_tuple(turn)}"
    yield f"        float physics:lowerLimit = {float(joint.lower * unit)!r}"
    yield f"        float physics:upperLimit = {float(joint.upper * unit)!r}"
    numbers = {
        "damping": joint.damping,
        "frictionloss": joint.friction,
        "stiffness": joint.stiffness,
        "springref": joint.rest,
        "armature": joint.armature,
    }
    for name, value in numbers.items():
        yield f"        double mjc:{name} = {float(value)!r}"
    yield "        double[] mjc:solreffriction = [0.004, 1]"
    yield "        double[] mjc:solimpfriction = [0.9999, 0.9999, 0.001, 0.5, 2]"
    yield "    }"


def _quaternion(axes: Floats) -> Floats:
    """w, x, y, z of a rotation matrix [3, 3]."""
    return np.asarray(Rotation.from_matrix(axes).as_quat(scalar_first=True))


def _tuple(values: Iterable[float]) -> str:
    return f"({', '.join(repr(float(value)) for value in values)})"
