"""The residual in force space, by inverse dynamics along the smoothed motion.

`mj_inverse` gives the generalized force that the scene needs for the measured acceleration (passive
forces, contacts and constraints are taken into account); what actuators and recorded forces give is
subtracted. The rest is what the scene lacks, plus noise: the standard deviation of the smoothed
acceleration through the inertia matrix.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.hidden import Layout, carried_along
from orbisim.diagnosis.samples import Samples
from orbisim.recording import estimate_motion
from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class ForceResidual:
    """Along one recording.

    Attributes:
      time: [T], s. force: [T, nv] missing generalized force, NaN where the motion is unknown.
      std: [T, nv] its standard deviation by measurement noise.
      total: [T, nv] the generalized force that the motion needs, for scale.
    """

    time: Floats
    force: Floats
    std: Floats
    total: Floats


def force_residual(samples: Sequence[Samples], scene: Scene) -> list[ForceResidual]:
    """The force-space residual of a scene along recordings.

    Args:
      samples: the recordings, prepared with the declared scene.
      scene: the declared scene, or one with effects added. Joints that an effect added rest;
        effects that MuJoCo cannot express natively are not taken into account.
    """
    return [_one(sample, scene) for sample in samples]


def _one(one: Samples, scene: Scene) -> ForceResidual:
    model, declared = scene.model, one.bound.model
    data, place = mujoco.MjData(model), Layout(declared, model)
    spread = np.nan_to_num(estimate_motion(one.bound).qacc_std)
    act, history = carried_along(one, declared, model)
    count, nv = len(one), declared.nv
    out = {name: np.full((count, nv), np.nan) for name in ("force", "std", "total")}
    full = np.zeros((model.nv, model.nv))
    for row in np.flatnonzero(one.usable):
        data.qpos[:], data.qvel[:], data.qacc[:] = model.qpos0, 0.0, 0.0
        data.qpos[place.q], data.qvel[place.v] = one.qpos[row], one.qvel[row]
        data.qacc[place.v] = one.qacc[row]
        data.ctrl[:] = one.ctrl[row]
        data.act[:] = act[row]
        if model.nhistory:
            data.history[:] = history[row]
        data.time = one.time[row]
        mujoco.mj_inverse(model, data)
        mujoco.mj_fwdActuation(model, data)
        mujoco.mj_fullM(model, data, full)
        inertia = full[np.ix_(place.v, place.v)]
        out["total"][row] = data.qfrc_inverse[place.v]
        missing = data.qfrc_inverse - data.qfrc_actuator
        out["force"][row] = missing[place.v] - one.force[row]
        out["std"][row] = np.sqrt((inertia**2) @ spread[row] ** 2)
    return ForceResidual(one.time, out["force"], out["std"], out["total"])
