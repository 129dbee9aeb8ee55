"""Reads `Limbs` of a MuJoCo model: the tree of joints, and the capsules that can touch."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim_world_model.frames import axis_frame, motion, nested, transform
from orbisim_world_model.layout import Limbs

Floats = npt.NDArray[np.float64]
_ROUND = (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_SPHERE))
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)


def read_limbs(model: mujoco.MjModel, scalar: list[int]) -> Limbs:
    """The tree and the capsules (a sphere is one without length) of all bodies that joints move.

    Args:
      model: whose joints are hinges and slides alone; empty `Limbs` otherwise.
      scalar: numbers of these joints.
    """
    if len(scalar) != model.njnt or not scalar:
        return Limbs()
    parents, bases, places = _tree(model, scalar)
    geoms = [g for g in range(model.ngeom) if _is_capsule(model, g)]
    geoms = [g for g in geoms if places[int(model.geom_bodyid[g])][0] >= 0]
    ends, joints = [], []
    for geom in geoms:
        joint, fixed = places[int(model.geom_bodyid[geom])]
        joints.append(joint)
        ends.append([_end(model, geom, fixed, side) for side in (-1.0, 1.0)])
    floor = _floor(model)
    below = [i for i, g in enumerate(geoms) if floor >= 0 and meet(model, g, floor)]
    numbers = range(len(geoms))
    pairs = [(i, j) for i in numbers for j in numbers if i < j and _pair(model, geoms[i], geoms[j])]
    return Limbs(
        parents=tuple(parents),
        bases=nested(np.array(bases)),
        joints=tuple(joints),
        ends=nested(np.array(ends).reshape(-1, 2, 3)),
        radii=tuple(float(model.geom_size[g, 0]) for g in geoms),
        grounded=tuple(below),
        height=float(model.geom_pos[floor, 2]) if floor >= 0 else 0.0,
        pairs=tuple(pairs),
        limits=nested(_limits(model, scalar)),
    )


def _tree(model: mujoco.MjModel, scalar: list[int]) -> tuple[list[int], list[Any], dict[int, Any]]:
    """Parent and transform of each joint, and for each body its last joint and pose in its frame.

    Each joint's frame has the axis as z and stands at the anchor (see `Layout.chain`).
    """
    parents: list[int] = []
    bases: list[Any] = []
    places: dict[int, tuple[int, Floats]] = {0: (-1, np.eye(4))}
    for body in range(1, model.nbody):
        last, outer = places[int(model.body_parentid[body])]
        fixed: Any = outer @ transform(model.body_pos[body], model.body_quat[body])
        first = int(model.body_jntadr[body])
        for joint in range(first, first + int(model.body_jntnum[body])):
            hinge = int(model.jnt_type[joint]) == _HINGE
            frame = axis_frame(model.jnt_axis[joint], model.jnt_pos[joint])
            if not hinge:
                frame[:3, 3] = 0.0
            reference = float(model.qpos0[model.jnt_qposadr[joint]])
            bases.append([fixed @ frame @ term for term in motion(hinge, reference)])
            parents.append(last)
            last, fixed = scalar.index(joint), np.linalg.inv(frame)
        places[body] = last, fixed
    return parents, bases, places


def _end(model: mujoco.MjModel, geom: int, fixed: Floats, side: float) -> Floats:
    """An end of a capsule's axis in the frame of the joint that moves it [3]."""
    capsule = int(model.geom_type[geom]) == _ROUND[0]
    length = side * float(model.geom_size[geom, 1]) if capsule else 0.0
    placed = fixed @ transform(model.geom_pos[geom], model.geom_quat[geom])
    return np.asarray((placed @ [0.0, 0.0, length, 1.0])[:3])


def _is_capsule(model: mujoco.MjModel, geom: int) -> bool:
    solid = model.geom_contype[geom] or model.geom_conaffinity[geom]
    return bool(solid) and int(model.geom_type[geom]) in _ROUND


def _floor(model: mujoco.MjModel) -> int:
    """The first plane of the world whose normal is vertical, or -1."""
    for geom in range(model.ngeom):
        plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
        frame = transform(model.geom_pos[geom], model.geom_quat[geom])
        if plane and not model.geom_bodyid[geom] and frame[2, 2] > 1.0 - 1e-9:
            return geom
    return -1


def _pair(model: mujoco.MjModel, a: int, b: int) -> bool:
    """Whether contacts between two moving geoms are looked for."""
    one, other = int(model.geom_bodyid[a]), int(model.geom_bodyid[b])
    bodies = [int(model.body_weldid[body]) for body in (one, other)]
    parents = [int(model.body_weldid[model.body_parentid[body]]) for body in bodies]
    excluded = {int(s) for s in model.exclude_signature}
    signature = (min(one, other) << 16) + max(one, other)
    related = bodies[0] == bodies[1] or bodies[0] == parents[1] or bodies[1] == parents[0]
    return not related and signature not in excluded and meet(model, a, b)


def meet(model: mujoco.MjModel, a: int, b: int) -> bool:
    """Whether the collision masks of two geoms let them touch."""
    if model.opt.disableflags & (
        mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_CONTACT
    ):
        return False
    types, affinities = model.geom_contype, model.geom_conaffinity
    return bool(types[a] & affinities[b] or types[b] & affinities[a])


def _limits(model: mujoco.MjModel, scalar: list[int]) -> Floats:
    """[J, 2]; a joint without limits has both 0."""
    limited = np.asarray(model.jnt_limited[scalar], bool)[:, None]
    return np.where(limited, model.jnt_range[scalar], 0.0)
