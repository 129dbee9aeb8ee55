"""Reads robots as limbs of a MuJoCo model: the layout, and the columns of `articulation`."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.errors import UnsupportedSceneError
from orbisim_world_model.articulation import CAPSULES, LIMB_COLUMNS
from orbisim_world_model.frames import transform
from orbisim_world_model.layout import Layout, Limbs
from orbisim_world_model.reading import read_layout
from orbisim_world_model.reading_limbs import meet

Floats = npt.NDArray[np.float64]
Row = dict[str, float]

_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_SCALAR = (int(mujoco.mjtJoint.mjJNT_SLIDE), _HINGE)
_ROUND = (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_SPHERE))
_PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
_UNBOUNDED = 1e9
"""What stands for no bound, beyond all forces and controls."""
_LEAST_STEP = 0.005
"""s: a scene with a finer timestep is stepped in the least multiple of it that is not shorter."""
_LEVEL = 1e-9
"""How far a floor's normal may be from the vertical."""
_DISABLE = mujoco.mjtDisableBit


def natural_step(model: mujoco.MjModel) -> float:
    """The step in which a model of limbs takes a scene, s."""
    own = float(model.opt.timestep)
    return own * max(1, math.ceil(_LEAST_STEP / own - 1e-9))


def read_articulated(model: mujoco.MjModel, timestep: float, *, source: str = "") -> Layout:
    """The layout of a scene whose robots are limbs.

    Args:
      model: the scene.
      timestep: of the learned step, s.
      source: the scene's name, for errors.

    Raises:
      UnsupportedSceneError: the scene has what limbs do not know (see `limb_rows`).
    """
    _refuse(model, source)
    plain = read_layout(model, timestep, hand="", source=source)
    count = max(1, round(timestep / float(model.opt.timestep)))
    if abs(count * float(model.opt.timestep) - timestep) > 1e-6 * timestep:
        raise UnsupportedSceneError(
            source,
            f"a learned step of {timestep:g} s is not a multiple of the scene's timestep of "
            f"{model.opt.timestep:g} s",
        )
    return dataclasses.replace(
        plain,
        servo=(),
        limbs=Limbs(),
        parts=tuple(range(len(plain.joints))),
        part_columns=LIMB_COLUMNS,
        substeps=count,
        runge_kutta=int(model.opt.integrator) == int(mujoco.mjtIntegrator.mjINT_RK4),
    )


def limb_rows(model: mujoco.MjModel, source: str = "") -> Floats:
    """[P, D]: the columns `LIMB_COLUMNS` of each joint; units are 0 until data are known.

    Raises:
      UnsupportedSceneError: the scene has what limbs do not know.
    """
    _refuse(model, source)
    motors = _motors(model, source)
    last = {int(model.jnt_bodyid[j]): j for j in range(model.njnt)}  # the body's last joint
    rows = []
    for joint in range(model.njnt):
        body = int(model.jnt_bodyid[joint])
        row = dict.fromkeys(LIMB_COLUMNS, 0.0) | _joint(model, joint, last)
        row |= _motor(model, motors.get(joint))
        if last[body] == joint:
            row |= _inertia(model, body) | _surface(model, body) | _shape(model, body)
        rows.append([row[name] for name in LIMB_COLUMNS])
    return np.array(rows, np.float64).reshape(len(rows), len(LIMB_COLUMNS))


def limb_concerns(model: mujoco.MjModel) -> list[str]:
    """What of a scene limbs see otherwise than MuJoCo does, one line each."""
    found = []
    for body in sorted({int(b) for b in model.jnt_bodyid}):
        solid = _solid(model, body)
        others = [g for g in solid if int(model.geom_type[g]) not in _ROUND]
        name = model.body(body).name
        if others:
            found.append(f"body {name!r}: {len(others)} geoms that are no capsules are seen as one")
        if len(solid) > CAPSULES:
            found.append(f"body {name!r}: the largest {CAPSULES} of {len(solid)} geoms are seen")
    if int(model.opt.integrator) == int(mujoco.mjtIntegrator.mjINT_IMPLICIT):
        found.append("the integrator 'implicit' is taken for 'implicitfast'")
    floor = _floor(model)
    still = [g for g in range(model.ngeom) if model.body_weldid[model.geom_bodyid[g]] == 0]
    moving = [g for g in range(model.ngeom) if model.body_weldid[model.geom_bodyid[g]] != 0]
    for geom in still:
        if geom != floor and any(meet(model, geom, other) for other in moving):
            found.append(f"contacts with geom {model.geom(geom).name or geom!r} are not known")
    return found


def _refuse(model: mujoco.MjModel, source: str) -> None:
    option = model.opt
    tendons = (model.tendon_stiffness, model.tendon_damping, model.tendon_frictionloss)
    problems = {
        "joints that are neither hinges nor slides": any(
            int(kind) not in _SCALAR for kind in model.jnt_type
        ),
        "a scene without joints": model.njnt == 0,
        "activations of actuators": model.na > 0,
        "equality constraints": bool(model.eq_active0.any()) if model.neq else False,
        "mocap bodies": model.nmocap > 0,
        "flexes": model.nflex > 0,
        "medium (density, viscosity or wind)": bool(
            option.density or option.viscosity or np.any(option.wind)
        ),
        "gravity compensation": bool(np.any(model.body_gravcomp)),
        "tendons with springs, dampers, friction or limits": any(
            bool(np.any(values)) for values in (*tendons, model.tendon_limited)
        ),
        "springs and dampers that are not linear": bool(
            np.any(model.jnt_stiffnesspoly) or np.any(model.dof_dampingpoly)
        ),
        "damping, armature or delay of actuators": any(
            bool(np.any(values))
            for values in (
                *(model.actuator_damping, model.actuator_dampingpoly),
                *(model.actuator_armature, model.actuator_delay),
            )
        ),
        "plugins": model.nplugin > 0,
        "bounds of the total force of actuators on a joint": bool(np.any(model.jnt_actfrclimited)),
    }
    for what, there in problems.items():
        if there:
            raise UnsupportedSceneError(source, f"a model of limbs knows no {what}")


def _joint(model: mujoco.MjModel, joint: int, last: dict[int, int]) -> Row:
    body, address = int(model.jnt_bodyid[joint]), int(model.jnt_qposadr[joint])
    dof = int(model.jnt_dofadr[joint])
    first = int(model.body_jntadr[body]) == joint
    parent, place = _attachment(model, body, last) if first else (joint - 1, np.eye(4))
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, place[:3, :3].ravel())
    damping = float(model.dof_damping[dof]) * (not _off(model, "mjDSBL_DAMPER"))
    explicit = _off(model, "mjDSBL_EULERDAMP") and not _implicit(model)
    bounded = bool(model.jnt_limited[joint]) and not _off(
        model, "mjDSBL_CONSTRAINT", "mjDSBL_LIMIT"
    )
    dry = not _off(model, "mjDSBL_CONSTRAINT", "mjDSBL_FRICTIONLOSS")
    low, high = model.jnt_range[joint] if bounded else (-np.pi, np.pi)
    carrier = int(model.body_weldid[model.body_parentid[model.body_weldid[body]]])
    known: Row = {
        "parent": float(parent),
        "type_hinge": float(model.jnt_type[joint] == _HINGE),
        "low": float(low),
        "high": float(high),
        "reference": float(model.qpos0[address]),
        "stiffness": float(model.jnt_stiffness[joint]) * (not _off(model, "mjDSBL_SPRING")),
        "springref": float(model.qpos_spring[address]),
        "damping": damping,
        "frictionloss": float(model.dof_frictionloss[dof]) * dry,
        "armature": float(model.dof_armature[dof]),
        "limited": float(bounded),
        "ignored": float(_slides_freely(model, joint)),
        "implicit": damping * (not explicit),
        "heavy": float(not _off(model, "mjDSBL_GRAVITY")),
        "body": float(body),
        "parent_body": float(carrier) if carrier else -1.0,  # the world's filters nothing
    }
    known |= _vector("axis", model.jnt_axis[joint]) | _vector("anchor", model.jnt_pos[joint])
    known |= _vector("base", place[:3, 3])
    known |= dict(zip(("base_qw", "base_qx", "base_qy", "base_qz"), map(float, quat), strict=True))
    limit = (*model.jnt_solref[joint], *model.jnt_solimp[joint, :3])
    names = [f"limit_solref_{i}" for i in range(2)] + [f"limit_solimp_{i}" for i in range(3)]
    return known | dict(zip(names, map(float, limit), strict=True))


def _implicit(model: mujoco.MjModel) -> bool:
    """Whether forces that depend on velocities are integrated implicitly."""
    kinds = (mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    return int(model.opt.integrator) in map(int, kinds)


def _slides_freely(model: mujoco.MjModel, joint: int) -> bool:
    """An unlimited horizontal slide of a root without a spring, over nothing but a level floor."""
    root = model.body_parentid[model.jnt_bodyid[joint]] == 0
    slide = int(model.jnt_type[joint]) != _HINGE and not model.jnt_limited[joint]
    level = abs(float(model.jnt_axis[joint] @ model.opt.gravity)) < _LEVEL
    return bool(root and slide and level and not model.jnt_stiffness[joint])


def _attachment(model: mujoco.MjModel, body: int, last: dict[int, int]) -> tuple[int, Floats]:
    """The joint that carries a body (-1: none), and the body's pose in the frame of its body."""
    pose = np.eye(4)
    while body:
        pose = transform(model.body_pos[body], model.body_quat[body]) @ pose
        body = int(model.body_parentid[body])
        if body in last:
            return last[body], pose
    return -1, pose


def _welded(model: mujoco.MjModel, body: int) -> dict[int, Floats]:
    """Bodies that are fixed to a moving one, itself among them, and their poses in its frame."""
    found = {body: np.eye(4)}
    for other in range(body + 1, model.nbody):
        if int(model.body_weldid[other]) == body:
            parent = found[int(model.body_parentid[other])]
            found[other] = parent @ transform(model.body_pos[other], model.body_quat[other])
    return found


def _inertia(model: mujoco.MjModel, body: int) -> Row:
    """Mass, centre and inertia about it of all that is fixed to a body, in its frame."""
    parts = []
    for other, pose in _welded(model, body).items():
        own = pose @ transform(model.body_ipos[other], model.body_iquat[other])
        tensor = own[:3, :3] @ np.diag(model.body_inertia[other]) @ own[:3, :3].T
        parts.append((float(model.body_mass[other]), own[:3, 3], tensor))
    mass = sum(m for m, _, _ in parts)
    centre = sum(m * c for m, c, _ in parts) / mass if mass else np.zeros(3)
    total = np.zeros((3, 3))
    for m, c, tensor in parts:
        arm = c - centre
        total += tensor + m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    six = [total[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    names = [f"inertia_{name}" for name in ("xx", "yy", "zz", "xy", "xz", "yz")]
    return {
        "mass": mass,
        **_vector("com", centre),
        **dict(zip(names, map(float, six), strict=True)),
    }


def _solid(model: mujoco.MjModel, body: int) -> list[int]:
    """Geoms of all that is fixed to a body that may touch anything, the largest first."""
    if _off(model, "mjDSBL_CONTACT", "mjDSBL_CONSTRAINT"):
        return []
    welded = _welded(model, body)
    geoms = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in welded]
    others = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) not in welded]
    found = [g for g in geoms if any(meet(model, g, other) for other in others)]
    return sorted(found, key=lambda g: -float(model.geom_rbound[g]))


def _surface(model: mujoco.MjModel, body: int) -> Row:
    solid, floor = _solid(model, body), _floor(model)
    if not solid:
        return {}
    geom = solid[0]
    touches = floor >= 0 and any(meet(model, g, floor) for g in solid)
    moving = [g for g in range(model.ngeom) if model.body_weldid[model.geom_bodyid[g]] != 0]
    welded = _welded(model, body)
    moving = [g for g in moving if int(model.geom_bodyid[g]) not in welded]
    friction = float(model.geom_friction[geom, 0])
    if touches:  # MuJoCo takes the larger of two
        friction = max(friction, float(model.geom_friction[floor, 0]))
    known: Row = {
        "friction": friction,
        "floor_there": float(touches),
        "floor": float(model.geom_pos[floor, 2]) if touches else 0.0,
        "meets": float(any(meet(model, g, other) for g in solid for other in moving)),
    }
    soft = (*model.geom_solref[geom], *model.geom_solimp[geom, :3])
    names = [f"solref_{i}" for i in range(2)] + [f"solimp_{i}" for i in range(3)]
    return known | dict(zip(names, map(float, soft), strict=True))


def _shape(model: mujoco.MjModel, body: int) -> Row:
    """Capsules; of another geom the one along its longest side that its bounding box holds."""
    known: Row = {}
    welded = _welded(model, body)
    for number, geom in enumerate(_solid(model, body)[:CAPSULES]):
        pose = welded[int(model.geom_bodyid[geom])] @ transform(
            model.geom_pos[geom], model.geom_quat[geom]
        )
        centre, half = np.zeros(3), np.zeros(3)
        if int(model.geom_type[geom]) == _ROUND[0]:
            radius, half[2] = float(model.geom_size[geom, 0]), float(model.geom_size[geom, 1])
        elif int(model.geom_type[geom]) == _ROUND[1]:
            radius = float(model.geom_size[geom, 0])
        else:
            box = np.asarray(model.geom_aabb[geom, 3:], np.float64)
            centre, long = np.asarray(model.geom_aabb[geom, :3], np.float64), int(box.argmax())
            radius = float(np.sort(box)[1])
            half[long] = max(float(box[long]) - radius, 0.0)
        ends = [(pose @ [*(centre + sign * half), 1.0])[:3] for sign in (-1.0, 1.0)]
        for name, end in zip("ab", ends, strict=True):
            known |= {
                f"{name}_{axis}_{number}": float(v) for axis, v in zip("xyz", end, strict=True)
            }
        known |= {f"radius_{number}": radius, f"there_{number}": 1.0}
        known[f"long_{number}"] = float(half.any())
    return known


def _floor(model: mujoco.MjModel) -> int:
    """The first plane of the world whose normal is vertical, or -1."""
    for geom in range(model.ngeom):
        frame = transform(model.geom_pos[geom], model.geom_quat[geom])
        level = frame[2, 2] > 1.0 - _LEVEL
        if model.geom_type[geom] == _PLANE and not model.geom_bodyid[geom] and level:
            return geom
    return -1


def _motors(model: mujoco.MjModel, source: str) -> dict[int, tuple[int, int, float]]:
    """By joint: control, actuator and gear.

    Raises:
      UnsupportedSceneError: an actuator has dynamics, a gain that is no constant, another
        transmission than one joint, or two of them drive one joint.
    """
    found: dict[int, tuple[int, int, float]] = {}
    if _off(model, "mjDSBL_ACTUATION"):
        return found
    for number in range(model.nactuator):
        name = model.actuator(number).name or f"actuator{number}"
        joints = _driven(model, number)
        simple = (
            int(model.actuator_dyntype[number]) == int(mujoco.mjtDyn.mjDYN_NONE)
            and int(model.actuator_gaintype[number]) == int(mujoco.mjtGain.mjGAIN_FIXED)
            and int(model.actuator_biastype[number])
            in (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
            and int(model.actuator_ctrlnum[number]) == 1
        )
        if not simple or len(joints) != 1:
            raise UnsupportedSceneError(
                source,
                f"a model of limbs knows actuators with a constant gain on one joint; {name!r} "
                f"acts on {len(joints)} joints"
                + ("" if simple else " and has dynamics of its own"),
            )
        joint, gear = next(iter(joints.items()))
        if joint in found:
            raise UnsupportedSceneError(
                source,
                f"a model of limbs knows one actuator a joint; {model.joint(joint).name!r} has two",
            )
        found[joint] = int(model.actuator_ctrladr[number]), number, gear
    return found


def _driven(model: mujoco.MjModel, actuator: int) -> dict[int, float]:
    """Joints that an actuator moves, with their gears; empty for what is no joint or tendon."""
    kind = int(model.actuator_trntype[actuator])
    target = int(model.actuator_trnid[actuator, 0])
    gear = float(model.actuator_gear[model.actuator_outadr[actuator], 0])
    if kind in (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)):
        return {target: gear}
    if kind != int(mujoco.mjtTrn.mjTRN_TENDON):
        return {}
    first = int(model.tendon_adr[target])
    rows = range(first, first + int(model.tendon_num[target]))
    if any(int(model.wrap_type[i]) != int(mujoco.mjtWrap.mjWRAP_JOINT) for i in rows):
        return {}
    found = {int(model.wrap_objid[i]): gear * float(model.wrap_prm[i]) for i in rows}
    return {joint: value for joint, value in found.items() if value}


def _motor(model: mujoco.MjModel, motor: tuple[int, int, float] | None) -> Row:
    if motor is None:
        return {"control": -1.0}
    control, number, gear = motor
    affine = int(model.actuator_biastype[number]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
    bias = model.actuator_biasprm[number, :3] * affine
    clamped = bool(model.actuator_ctrllimited[control]) and not _off(model, "mjDSBL_CLAMPCTRL")
    low, high = model.actuator_ctrlrange[control] if clamped else (-_UNBOUNDED, _UNBOUNDED)
    strong = bool(model.actuator_forcelimited[number])
    least, most = model.actuator_forcerange[number] if strong else (-_UNBOUNDED, _UNBOUNDED)
    names = ("control", "gear", "gain", "bias_0", "bias_1", "bias_2")
    values = (control, gear, model.actuator_gainprm[number, 0], *bias)
    ends = {"ctrl_low": low, "ctrl_high": high, "force_low": least, "force_high": most}
    known = {k: float(v) for k, v in (*zip(names, values, strict=True), *ends.items())}
    return {**known, "motor_implicit": float(_implicit(model))}


def _vector(name: str, values: Any) -> Row:
    return {f"{name}_{axis}": float(v) for axis, v in zip("xyz", values, strict=True)}


def _off(model: mujoco.MjModel, *flags: str) -> bool:
    """Whether one of these parts of the engine is switched off."""
    return any(int(model.opt.disableflags) & int(getattr(_DISABLE, flag)) for flag in flags)
