"""The tangent space of a state: (dq [nv], v [nv], act [na]), as in `mujoco.mjd_transitionFD`."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.state import State

Floats = npt.NDArray[np.float64]


def perturbed(model: mujoco.MjModel, state: State, dx: Floats) -> State:
    """The state moved by tangent vectors dx [nworld, 2 nv + na]."""
    nv = model.nv
    qpos = np.array(state.qpos, np.float64)
    for world in range(state.nworld):
        mujoco.mj_integratePos(model, qpos[world], np.ascontiguousarray(dx[world, :nv]), 1.0)
    return state.replace(
        qpos=qpos, qvel=state.qvel + dx[:, nv : 2 * nv], act=state.act + dx[:, 2 * nv :]
    )


def tangent_difference(model: mujoco.MjModel, start: State, end: State) -> Floats:
    """Tangent vectors [nworld, 2 nv + na] that lead from `start` to `end`."""
    dq = np.empty((start.nworld, model.nv))
    for world in range(start.nworld):
        mujoco.mj_differentiatePos(
            model,
            dq[world],
            1.0,
            np.ascontiguousarray(start.qpos[world], np.float64),
            np.ascontiguousarray(end.qpos[world], np.float64),
        )
    return np.concatenate([dq, end.qvel - start.qvel, end.act - start.act], axis=1)
