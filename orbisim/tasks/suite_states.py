"""Initial states from the whole range that a mechanism can reach."""

from __future__ import annotations

import mujoco
import numpy as np

_HINGE_SPEED, _SLIDE_SPEED = 3.0, 1.0
_DEEPEST = -0.002
"""Penetration in m with which an episode may start: MuJoCo's soft contacts rest about so deep."""
_TRIES = 30
"""Draws of a start; after them the episode starts where the task does."""


def spread_out(model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
    """Joints anywhere in their range (unlimited hinges anywhere), velocities at random.

    Mechanisms with a vertical root slide are lifted out of the floor; others are drawn again until
    nothing penetrates. If nothing is found the state stays.
    """
    before = data.qpos.copy(), data.qvel.copy()
    for _ in range(_TRIES):
        data.qpos[:], data.qvel[:] = before
        _draw(model, data, rng)
        if _lift(model, data):
            return
    data.qpos[:], data.qvel[:] = before


def _draw(model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
    scale = rng.uniform(0, 1)
    for joint in range(model.njnt):
        adr, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        kind = model.jnt_type[joint]
        if kind == mujoco.mjtJoint.mjJNT_HINGE:
            limited = model.jnt_limited[joint]
            low, high = model.jnt_range[joint] if limited else (-np.pi, np.pi)
            data.qpos[adr] = rng.uniform(low, high)
            data.qvel[dof] = scale * _HINGE_SPEED * rng.standard_normal()
        elif kind == mujoco.mjtJoint.mjJNT_SLIDE:
            if model.jnt_limited[joint]:
                data.qpos[adr] = rng.uniform(*model.jnt_range[joint])
            data.qvel[dof] = scale * _SLIDE_SPEED * rng.standard_normal()


def _lift(model: mujoco.MjModel, data: mujoco.MjData) -> bool:
    """Raises a vertical root slide until nothing penetrates; whether nothing does."""
    root = _vertical_slide(model)
    for _ in range(5):
        mujoco.mj_fwdPosition(model, data)
        depth = min((float(contact.dist) for contact in data.contact), default=0.0)
        if depth >= _DEEPEST:
            return True
        if root is None:
            return False
        data.qpos[root] -= depth
    return False


def _vertical_slide(model: mujoco.MjModel) -> int | None:
    for joint in range(model.njnt):
        slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
        body = model.jnt_bodyid[joint]
        if slide and model.body_parentid[body] == 0 and abs(model.jnt_axis[joint, 2]) > 0.9:
            return int(model.jnt_qposadr[joint])
    return None
