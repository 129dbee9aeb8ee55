"""Reads the `Pad`s of a MuJoCo model: boxes of the hand that objects can touch."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim_world_model.frames import nested
from orbisim_world_model.layout import Pad
from orbisim_world_model.reading_limbs import meet

Floats = npt.NDArray[np.float64]
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
_BOX, _FREE = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtJoint.mjJNT_FREE)


def read_pads(
    model: mujoco.MjModel, hand: str, scalar: list[int], members: tuple[int, ...]
) -> tuple[Pad, ...]:
    """Boxes that move with the hand, or on one slide joint of it.

    Args:
      model: the scene.
      hand: site of the hand.
      scalar: numbers of the scalar joints, as `Layout.joints` has them.
      members: those before the hand (see `Layout.chain_joints`).
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    site = int(model.site(hand).id)
    known = {scalar[member] for member in members}
    free = _free_geoms(model)
    found = []
    for geom in range(model.ngeom):
        joints = _joints(model, int(model.geom_bodyid[geom]))
        beyond = [j for j in joints if j not in known]
        solid = any(meet(model, geom, other) for other in free)
        if int(model.geom_type[geom]) != _BOX or not solid or not known <= set(joints):
            continue
        if len(beyond) > 1 or any(int(model.jnt_type[j]) != _SLIDE for j in beyond):
            continue
        found.append(_pad(model, data, geom, site, beyond, scalar))
    return tuple(found)


def _pad(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    geom: int,
    site: int,
    beyond: list[int],
    scalar: list[int],
) -> Pad:
    origin, turn = data.site_xpos[site], data.site_xmat[site].reshape(3, 3)
    axis = turn.T @ data.xaxis[beyond[0]] if beyond else np.zeros(3)
    return Pad(
        pos=_three(turn.T @ (data.geom_xpos[geom] - origin)),
        rot=nested(turn.T @ data.geom_xmat[geom].reshape(3, 3)),
        half=_three(model.geom_size[geom]),
        joint=scalar.index(beyond[0]) if beyond else -1,
        axis=_three(axis),
        zero=float(model.qpos0[model.jnt_qposadr[beyond[0]]]) if beyond else 0.0,
        friction=float(model.geom_friction[geom, 0]),
    )


def _three(vector: Floats) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector)
    return x, y, z


def _joints(model: mujoco.MjModel, body: int) -> list[int]:
    """All joints that move a body."""
    joints: list[int] = []
    while body:
        first = int(model.body_jntadr[body])
        joints += range(first, first + int(model.body_jntnum[body]))
        body = int(model.body_parentid[body])
    return joints


def _free_geoms(model: mujoco.MjModel) -> list[int]:
    """Geoms of bodies with a free joint."""
    joints = [int(model.body_jntadr[body]) for body in model.geom_bodyid]
    return [g for g, j in enumerate(joints) if j >= 0 and int(model.jnt_type[j]) == _FREE]
