"""Equality constraints: MuJoCo's own, coupled joints, and joints that close loops."""

from __future__ import annotations

import mujoco
import numpy as np

from orbisim.scene.usd import tables
from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.bodies import Bodies
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.flat import FloatArray
from orbisim.scene.usd.joints import BALL, HINGE, Joint, frame_on, is_equality
from orbisim.scene.usd.pose import Pose, rotate
from orbisim.scene.usd.registry import Registry
from orbisim.scene.usd.sites import add_marker
from orbisim.scene.usd.tables import Field
from orbisim.scene.usd.units import DEGREE

_EQ = mujoco.mjtEq
_OBJ = mujoco.mjtObj
_TORQUE_SCALE = 10  # index into the data of a weld
_LEVER = 0.05  # m, least distance between the two points that hold a hinge
_FIELDS = (
    Field("mjc:solimp", "solimp", tables.vector),
    Field("mjc:solref", "solref", tables.vector),
)
_MIMIC_SCHEMA = "PhysxMimicJointAPI:"


def add_equalities(context: Context, registry: Registry, bodies: Bodies) -> None:
    """Adds what the stage itself declares as constraints, in its order."""
    for prim in context.prims.values():
        if is_equality(prim):
            _add_native(context, registry, bodies, prim)
        if prim.has("NewtonMimicAPI") or prim.has("MjcEqualityJointAPI"):
            _add_mimic(context, registry, prim)
        for schema in prim.flat.schemas:
            if schema.startswith(_MIMIC_SCHEMA):
                _add_physx_mimic(context, registry, prim, schema.removeprefix(_MIMIC_SCHEMA))


def _add_native(context: Context, registry: Registry, bodies: Bodies, prim: Prim) -> None:
    ends = [context.target(prim, f"physics:body{side}") for side in (0, 1)]
    owners = [bodies.owner(end) if end else None for end in ends]
    paths = [owner.path if owner else None for owner in owners]
    frames = [frame_on(context, prim, side, ends[side], paths[side]) for side in (0, 1)]
    sites = [end is not None and end in registry.sites for end in ends]
    if paths[0] == paths[1]:
        context.omit(prim.path, "a constraint of a body to itself", "left out")
        return
    equality = registry.spec.add_equality(
        name=registry.equality_names(prim.flat.display_name or prim.flat.name)
    )
    weld = prim.has("MjcEqualityWeldAPI")
    equality.type = _EQ.mjEQ_WELD if weld else _EQ.mjEQ_CONNECT
    equality.active = prim.flag("physics:jointEnabled", True)
    prim.use("physics:excludeFromArticulation", "physics:axis", "physics:collisionEnabled")
    tables.apply(_FIELDS, prim, equality)
    scale = prim.number("mjc:torqueScale")
    data = np.array(equality.data)
    if all(sites):
        equality.objtype = _OBJ.mjOBJ_SITE
        equality.name1, equality.name2 = (registry.sites[end or ""] for end in ends)
    else:
        equality.objtype = _OBJ.mjOBJ_BODY
        equality.name1, equality.name2 = (registry.bodies[path or ""] for path in paths)
        data[:10] = _weld_data(frames[0], frames[1]) if weld else [*frames[0].pos, *np.zeros(7)]
    if weld:
        data[_TORQUE_SCALE] = 1.0 if scale is None else scale
    equality.data = data


def _weld_data(frame0: Pose, frame1: Pose) -> FloatArray:
    """MuJoCo's anchor (in body 2) and pose of body 2 relative to body 1."""
    relative = frame0 @ Pose(quat=frame1.quat).inverse()
    return np.array([*frame1.pos, *(frame0.pos - rotate(relative.quat, frame1.pos)),
                     *relative.quat])  # fmt: skip


def _add_mimic(context: Context, registry: Registry, prim: Prim) -> None:
    """follower = coef0 + coef1 leader (+ MuJoCo's higher terms)."""
    leader = context.target(prim, "newton:mimicJoint") or context.target(prim, "mjc:target")
    names, others = registry.joints.get(prim.path, []), registry.joints.get(leader or "", [])
    if len(names) != 1 or len(others) != 1:
        context.omit(prim.path, "NewtonMimicAPI", "the joint is not coupled")
        return
    angular = registry.joint_types[names[0]] == mujoco.mjtJoint.mjJNT_HINGE
    unit = DEGREE if angular else context.units.length
    offset = prim.number("newton:mimicCoef0", unit)
    factor = prim.number("newton:mimicCoef1")
    native = [prim.number(f"mjc:coef{i}") for i in range(5)]
    polynomial = [
        offset if offset is not None else native[0] or 0.0,
        factor if factor is not None else (1.0 if native[1] is None else native[1]),
        *(value or 0.0 for value in native[2:]),
    ]
    equality = _couple(registry, names[0], others[0], polynomial)
    equality.active = prim.flag("newton:mimicEnabled", True)
    tables.apply(_FIELDS, prim, equality)


def _add_physx_mimic(context: Context, registry: Registry, prim: Prim, token: str) -> None:
    """PhysX: q + gearing q_reference + offset = 0."""
    stem = f"physxMimicJoint:{token}:"
    leader = context.target(prim, f"{stem}referenceJoint")
    names, others = registry.joints.get(prim.path, []), registry.joints.get(leader or "", [])
    gearing, prismatic = prim.number(f"{stem}gearing"), token.startswith("trans")
    offset = prim.number(f"{stem}offset", context.units.length if prismatic else DEGREE)
    prim.use(f"{stem}referenceJointAxis")
    if len(names) != 1 or len(others) != 1:
        context.omit(prim.path, f"{_MIMIC_SCHEMA}{token}", "the joint is not coupled")
        return
    polynomial = [-(offset or 0.0), -(1.0 if gearing is None else gearing), 0.0, 0.0, 0.0]
    _couple(registry, names[0], others[0], polynomial)


def _couple(
    registry: Registry, follower: str, leader: str, polynomial: list[float]
) -> mujoco.MjsEquality:
    equality = registry.spec.add_equality(name=registry.equality_names(f"{follower}_mimic"))
    equality.type = _EQ.mjEQ_JOINT
    equality.name1, equality.name2 = follower, leader
    data = np.array(equality.data)
    data[:5] = polynomial
    equality.data = data
    return equality


def close_loop(context: Context, registry: Registry, joint: Joint) -> None:
    """Expresses a joint that is not part of a tree by constraints between sites.

    Raises:
      SceneError: no equality constraint leaves the joint's freedom.
    """
    name = joint.prim.flat.display_name or joint.prim.flat.name
    kinds = [dof.kind for dof in joint.dofs]
    if joint.is_driven:
        context.omit(
            joint.path, "limits and drives of a joint that closes a loop", "the joint moves freely"
        )
    if not kinds:
        _hold(registry, joint, _EQ.mjEQ_WELD, name, Pose())
    elif kinds == [BALL]:
        _hold(registry, joint, _EQ.mjEQ_CONNECT, name, Pose())
    elif kinds == [HINGE]:
        lever = np.eye(3)[joint.dofs[0].axis] * max(_LEVER, _reach(joint) / 2)
        _hold(registry, joint, _EQ.mjEQ_CONNECT, f"{name}_a", Pose(lever))
        _hold(registry, joint, _EQ.mjEQ_CONNECT, f"{name}_b", Pose(-lever))
    else:
        raise joint.prim.error(
            f"closes a loop as a {joint.type_name} with {len(kinds)} degrees of freedom "
            f"({', '.join(dof.token for dof in joint.dofs)}), which no equality constraint "
            "expresses",
            "set physics:excludeFromArticulation on a fixed, spherical or revolute joint of the "
            "loop instead",
        )


def _reach(joint: Joint) -> float:
    """A length that is typical of the bodies that a joint joins."""
    ends = [(joint.body0, joint.frame0), (joint.body1, joint.frame1)]
    return max(float(np.linalg.norm(frame.pos)) for body, frame in ends if body is not None)


def _hold(registry: Registry, joint: Joint, kind: mujoco.mjtEq, name: str, where: Pose) -> None:
    """Holds two sites together, each at `where` in its joint frame."""
    first = add_marker(registry, joint.body0, joint.frame0 @ where, f"{name}_0")
    second = add_marker(registry, joint.body1, joint.frame1 @ where, f"{name}_1")
    equality = registry.spec.add_equality(name=registry.equality_names(name))
    equality.type, equality.objtype = kind, _OBJ.mjOBJ_SITE
    equality.name1, equality.name2 = first, second
    if kind == _EQ.mjEQ_WELD:
        data = np.array(equality.data)
        data[_TORQUE_SCALE] = 1.0
        equality.data = data
