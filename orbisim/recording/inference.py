"""Joint positions that are not recorded but follow from what is."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.recording.joints import Joint, Kind, body_label, joints

Floats = npt.NDArray[np.float64]
Poses = Mapping[int, Floats]
"""Samples [T, 3] or [T, 4] by body."""


def from_own_pose(
    model: mujoco.MjModel, qpos: Floats, joint: Joint, xpos: Poses, xquat: Poses
) -> str | None:
    """Fills a free joint's columns of `qpos` [T, nq] from the pose of its body.

    Returns:
      A note if something had to be assumed, "" if not; None if the pose is not recorded.
    """
    if joint.kind != Kind.FREE or joint.body not in xpos:
        return None
    quat = slice(joint.q.start + 3, joint.q.stop)
    if joint.body in xquat:
        qpos[:, quat] = xquat[joint.body]
    elif not turns_unseen(model, joint.body):
        return None
    qpos[:, joint.q.start : joint.q.start + 3] = xpos[joint.body]
    if joint.body in xquat:
        return ""
    qpos[:, quat] = np.array([1.0, 0.0, 0.0, 0.0])
    return (
        f"orientation of body {body_label(model, joint.body)!r} is not recorded; it is a sphere, "
        "so it is taken as not turned"
    )


def turns_unseen(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body is a sphere about its own origin: turning it changes nothing."""
    if (model.body_parentid[1:] == body).any() or not model.body_mass[body]:
        return False
    inertia = model.body_inertia[body]
    geoms = np.flatnonzero(model.geom_bodyid == body)
    solid = geoms[(model.geom_contype[geoms] != 0) | (model.geom_conaffinity[geoms] != 0)]
    sphere = int(mujoco.mjtGeom.mjGEOM_SPHERE)
    return bool(
        np.ptp(inertia) <= 1e-6 * inertia.max()
        and np.abs(model.body_ipos[body]).max() < 1e-9
        and (model.geom_type[solid] == sphere).all()
        and np.abs(model.geom_pos[solid]).max(initial=0.0) < 1e-9
    )


def from_couplings(model: mujoco.MjModel, qpos: Floats, known: set[int]) -> dict[int, int]:
    """Fills joints that joint equalities tie to recorded ones (URDF's mimic).

    MuJoCo's constraint is q1 - q1_0 = sum_k c_k (q2 - q2_0)^k; it is used from q2 to q1, and back
    where it is linear.

    Args:
      model: the model.
      qpos: [T, nq], written to.
      known: numbers of joints that are known; grows.

    Returns:
      The joints that were filled, each with the joint it follows.
    """
    found: dict[int, int] = {}
    every = joints(model)
    ties = [
        (int(model.eq_obj1id[e]), int(model.eq_obj2id[e]), np.array(model.eq_data[e, :5]))
        for e in range(model.neq)
        if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT and model.eq_active0[e]
    ]
    for _ in ties:  # a chain is no longer than there are ties
        for first, second, poly in ties:
            if first not in known and (second < 0 or second in known):
                offset = _offset(model, qpos, every[second]) if second >= 0 else np.zeros(len(qpos))
                value = np.polynomial.polynomial.polyval(offset, poly)
                target, source = first, second
            elif second >= 0 and second not in known and first in known and _linear(poly):
                value = (_offset(model, qpos, every[first]) - poly[0]) / poly[1]
                target, source = second, first
            else:
                continue
            adr = every[target].q.start
            qpos[:, adr] = model.qpos0[adr] + value
            known.add(target)
            found[target] = source
    return found


def _offset(model: mujoco.MjModel, qpos: Floats, joint: Joint) -> Floats:
    return np.asarray(qpos[:, joint.q.start] - model.qpos0[joint.q.start])


def _linear(poly: Floats) -> bool:
    return bool(poly[1] != 0 and (poly[2:] == 0).all())
