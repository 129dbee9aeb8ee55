"""What moves what in a scene: the questions that identities of mechanics rest on."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.effects.base import index_of, names_of_kind

Floats = npt.NDArray[np.float64]

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


def names(model: mujoco.MjModel, kind: str) -> tuple[str, ...]:
    """Names of all elements of a kind."""
    return tuple(names_of_kind(model, kind))


def only_joint(model: mujoco.MjModel, body: str) -> str | None:
    """The joint that alone moves a body, if it is a single hinge or slide."""
    number, found = index_of(model, "body", body), []
    while number:
        first = int(model.body_jntadr[number])
        found += range(first, first + int(model.body_jntnum[number]))
        number = int(model.body_parentid[number])
    if len(found) != 1 or int(model.jnt_type[found[0]]) not in (HINGE, SLIDE):
        return None
    return str(model.joint(found[0]).name)


def moved_only_by(model: mujoco.MjModel, joint: str) -> list[str]:
    """Bodies with mass that this joint alone moves."""
    return [
        body
        for number, body in enumerate(names(model, "body"))
        if number and model.body_mass[number] > 0 and only_joint(model, body) == joint
    ]


def slides(model: mujoco.MjModel, joint: str) -> bool:
    """Whether it is a slide."""
    return int(model.jnt_type[index_of(model, "joint", joint)]) == SLIDE


def level(model: mujoco.MjModel, joint: str) -> bool:
    """Whether it is a slide along which gravity does nothing."""
    across = abs(axis(model, joint) @ np.array(model.opt.gravity))
    return slides(model, joint) and bool(across <= 1e-9)


def axis(model: mujoco.MjModel, joint: str) -> Floats:
    """Direction [3] in the world of a joint whose body hangs on nothing else that moves."""
    return np.array(_reference(model).xaxis[index_of(model, "joint", joint)])


def lever(model: mujoco.MjModel, body: str, joint: str) -> float:
    """Speed of the body's centre of mass over that of the joint that alone moves it: m, or 1."""
    if slides(model, joint):
        return 1.0
    data, number = _reference(model), index_of(model, "joint", joint)
    arm = data.xipos[index_of(model, "body", body)] - data.xanchor[number]
    return float(np.linalg.norm(np.cross(data.xaxis[number], arm)))


def motors(model: mujoco.MjModel, joint: str) -> list[tuple[str, float]]:
    """Actuators that give their force to a joint as it is, with no limit on it, and their gear."""
    number, found = index_of(model, "joint", joint), []
    for a, name in enumerate(names(model, "actuator")):
        at_joint = int(model.actuator_trntype[a]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        if at_joint and int(model.actuator_trnid[a, 0]) == number:
            limited = model.actuator_forcelimited[a] or model.jnt_actfrclimited[number]
            found += [] if limited else [(name, float(model.actuator_gear[a, 0]))]
    return found


def touches(model: mujoco.MjModel, body: str) -> bool:
    """Whether the body, or one that hangs on it, has geoms that can touch something."""
    number = index_of(model, "body", body)
    for geom in range(model.ngeom):
        if model.geom_contype[geom] or model.geom_conaffinity[geom]:
            owner = int(model.geom_bodyid[geom])
            while owner and owner != number:
                owner = int(model.body_parentid[owner])
            if owner == number:
                return True
    return False


def cyclic_hinge(model: mujoco.MjModel, servo: bool = False) -> str | None:
    """The hinge that carries all that moves, if nothing but gravity depends on its angle.

    There must be no limit or spring at it, no actuator that feels its position, no equality, tendon
    or wind, and nothing that touches.

    Args:
      servo: whether a position servo may act at the hinge.
    """
    roots = [b for b in range(1, model.nbody) if model.body_weldid[b] and _hangs_on_world(model, b)]
    if len(roots) != 1 or int(model.body_jntnum[roots[0]]) != 1:
        return None
    joint = int(model.body_jntadr[roots[0]])
    free = int(model.jnt_type[joint]) == HINGE and not model.jnt_limited[joint]
    springs = np.any(model.jnt_stiffness[joint]) or _feels_position(model, joint, servo)
    other = model.neq or model.ntendon or np.any(model.opt.wind)
    if not free or springs or other or touches(model, model.body(roots[0]).name):
        return None
    return str(model.joint(joint).name)


def _hangs_on_world(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body that moves has a parent that does not."""
    return not model.body_weldid[int(model.body_parentid[body])]


def _feels_position(model: mujoco.MjModel, joint: int, servo: bool) -> bool:
    """Whether the force of an actuator depends on the joint's position.

    Args:
      servo: whether one at the joint may.
    """
    for a in range(model.nactuator):
        kinds = (int(model.actuator_gaintype[a]), int(model.actuator_biastype[a]))
        known = kinds[0] == int(mujoco.mjtGain.mjGAIN_FIXED) and kinds[1] in (
            int(mujoco.mjtBias.mjBIAS_NONE),
            int(mujoco.mjtBias.mjBIAS_AFFINE),
        )
        at_joint = int(model.actuator_trntype[a]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        own = at_joint and int(model.actuator_trnid[a, 0]) == joint
        spring = kinds[1] == int(mujoco.mjtBias.mjBIAS_AFFINE) and model.actuator_biasprm[a, 1]
        if not at_joint or not known or (own and spring and not servo):
            return True
    return False


def planar_normal(model: mujoco.MjModel) -> Floats | None:
    """The axis [3] along which nothing in the scene ever moves, if hinges say which it is."""
    data, kinds = _reference(model), np.array(model.jnt_type)
    hinges, slides_ = data.xaxis[kinds == HINGE], data.xaxis[kinds == SLIDE]
    if len(hinges) + len(slides_) != model.njnt or not len(hinges):
        return None
    normal = np.array(hinges[0])
    parallel = np.allclose(np.abs(hinges @ normal), 1.0, atol=1e-9)
    return normal if parallel and np.allclose(slides_ @ normal, 0.0, atol=1e-9) else None


def _reference(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data
