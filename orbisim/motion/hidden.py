"""States that a variant of the scene has and a recording does not show.

A variant has the declared coordinates and perhaps more: joints for play or elasticity, activations
of a lag, buffers of a delay.
"""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.motion.samples import Samples, substeps
from orbisim.recording.joints import joints
from orbisim.recording.zero_order_hold import Held

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


class Layout:
    """Where the declared scene's coordinates stand in a variant.

    Attributes:
      q: [nq] addresses in the variant's qpos. v: [nv] addresses in its qvel.
      hidden_q, hidden_v: addresses of the hinges and slides that effects have added.
    """

    def __init__(self, declared: mujoco.MjModel, variant: mujoco.MjModel) -> None:
        own = {j.label: j for j in joints(variant)}
        self.q, self.v = np.zeros(declared.nq, int), np.zeros(declared.nv, int)
        for joint in joints(declared):
            there = own[joint.label]
            self.q[joint.q] = np.arange(there.q.start, there.q.stop)
            self.v[joint.v] = np.arange(there.v.start, there.v.stop)
        declared_names = {j.label for j in joints(declared)}
        extra = [j for j in joints(variant) if j.label not in declared_names]
        self.hidden_q = np.array([j.q.start for j in extra], int)
        self.hidden_v = np.array([j.v.start for j in extra], int)


def carried_along(
    one: Samples, declared: mujoco.MjModel, variant: mujoco.MjModel, rows: Ints | None = None
) -> tuple[Floats, Floats]:
    """Activations [R, na] and delay buffers [R, nhistory] of a variant at some samples.

    Args:
      rows: [R] numbers of the samples; all if None.

    Activations that the declared scene has are the recording's own; those of an added lag follow
    from the controls.
    """
    rows = np.arange(len(one)) if rows is None else rows
    if declared.na == variant.na and declared.nhistory == variant.nhistory:
        return one.act[rows], one.history[rows]
    act = np.zeros((len(one), variant.na))
    for a in range(variant.nactuator):
        adr = int(variant.actuator_actadr[a])
        if adr < 0:
            continue
        before = int(declared.actuator_actadr[a]) if a < declared.nactuator else -1
        if before >= 0:
            act[:, adr] = one.act[:, before]
        elif variant.actuator_ctrlnum[a]:
            control = one.ctrl[:, int(variant.actuator_ctrladr[a])]
            act[:, adr] = first_order(one.time, control, float(variant.actuator_dynprm[a, 0]))
    return act[rows], _buffers(one, variant, rows)


def first_order(time: Floats, held: Floats, time_constant: float) -> Floats:
    """A held signal [T] after a first-order filter that starts at rest, exactly."""
    out = np.empty(len(held))
    decay = np.exp(-np.diff(time) / time_constant)
    out[0] = held[0]
    for k in range(len(held) - 1):
        out[k + 1] = held[k] + (out[k] - held[k]) * decay[k]
    return out


def _buffers(one: Samples, variant: mujoco.MjModel, rows: Ints) -> Floats:
    found = np.zeros((len(rows), variant.nhistory))
    if not variant.nhistory:
        return found
    held, data = Held(one.time, one.ctrl), mujoco.MjData(variant)
    typical = float(np.median(np.diff(one.time)))
    step = typical / int(substeps(np.array(typical), variant.opt.timestep))
    delayed = np.flatnonzero(variant.actuator_historyadr >= 0)
    for place, row in enumerate(rows):
        for a in delayed:
            n = int(variant.actuator_history[a, 0])
            times = one.time[row] - step * np.arange(n, 0, -1)
            column = int(variant.actuator_ctrladr[a])
            values = held.at(times + 1e-6 * step)[:, column]
            mujoco.mj_initCtrlHistory(variant, data, int(a), times, values)
        found[place] = data.history
    return found
