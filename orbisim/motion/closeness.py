"""Which geoms may touch something between two samples.

What acts at contacts changes nothing where there are none. A contact may come and go between two
samples, so geoms count as touching that are closer than they move from one sample to the next.
"""

from __future__ import annotations

import copy

import mujoco
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
State = tuple[Floats, Floats]
"""Positions [N, nq] and velocities [N, nv]."""


def may_touch(model: mujoco.MjModel, before: State, after: State, duration: Floats) -> Bools:
    """[N, ngeom]: whether a geom may touch something in an interval; False where the states are not
    known, and True everywhere where there are flexible objects, whose points move by themselves.

    Args:
      model: of the scene. before, after: at the ends of the intervals. duration: [N] of these, s.
    """
    wide, data = copy.copy(model), mujoco.MjData(model)
    margin, pair_margin = model.geom_margin.copy(), model.pair_margin.copy()
    known = np.isfinite(np.concatenate([*before, *after], axis=1)).all(axis=1)
    found = np.zeros((len(known), model.ngeom), bool)
    if model.nflex:
        return ~found
    # what rests has no speed; without its contact it would fall half as far
    fall = float(np.linalg.norm(model.opt.gravity)) * duration**2
    for k in np.flatnonzero(known):
        back = _moved(model, data, after[0][k], -duration[k] * after[1][k])
        on = _moved(model, data, before[0][k], duration[k] * before[1][k])
        # of two that move towards each other, twice the faster one's way is enough
        room = 2.0 * (np.maximum(back, on) + fall[k])
        wide.geom_margin[:] = margin + room
        wide.body_margin[:] = 0.0
        np.maximum.at(wide.body_margin, model.geom_bodyid, wide.geom_margin)
        wide.pair_margin[:] = pair_margin + np.maximum(
            room[model.pair_geom1], room[model.pair_geom2]
        )
        data.qpos[:] = before[0][k]
        for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_collision):
            stage(wide, data)
        found[k, data.contact.geom[: data.ncon].ravel()] = True
    return found


def _moved(model: mujoco.MjModel, data: mujoco.MjData, qpos: Floats, way: Floats) -> Floats:
    """[ngeom]: how far a point of a geom comes at most, m, as joints move by [nv] so much."""
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    place, turn = data.geom_xpos.copy(), data.geom_xmat.copy()
    mujoco.mj_integratePos(model, data.qpos, way, 1.0)
    mujoco.mj_kinematics(model, data)
    # the Frobenius norm of a change of the frame bounds what it moves at a distance of 1
    turned = np.linalg.norm(data.geom_xmat - turn, axis=1) * model.geom_rbound
    return np.asarray(np.linalg.norm(data.geom_xpos - place, axis=1) + turned)
