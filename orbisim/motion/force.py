"""The residual in force space, by inverse dynamics along the smoothed motion.

`mj_inverse` gives the generalized force that the scene needs for the measured acceleration (passive
forces, contacts and constraints are taken into account); what actuators and recorded forces give is
subtracted. The rest is what the scene lacks, plus noise: the standard deviation of the smoothed
acceleration through the inertia matrix.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.effects.carry import hooks_of
from orbisim.effects.running import ACCELERATION_STAGE, HookRunner
from orbisim.motion.hidden import Layout, carried_along
from orbisim.motion.samples import Samples
from orbisim.recording.command_clock import Lead
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


def force_residual(samples: Sequence[Samples], scene: Scene, every: int = 1) -> list[ForceResidual]:
    """The force-space residual of a scene along recordings.

    Args:
      samples: the recordings, prepared with the declared scene.
      scene: the declared scene, or one with effects added. Joints that an effect added rest.
      every: only every so many usable rows are computed; the others are NaN.
    """
    return [_one(sample.led(Lead()), sample.qacc_std, scene, every) for sample in samples]


def _one(one: Samples, spread: Floats, scene: Scene, every: int) -> ForceResidual:
    # the spread is a smoothing's: that of the samples as they came, which keep it
    model, declared = copy.copy(scene.model), one.bound.model
    hooked = Hooked(model)
    data, place = mujoco.MjData(model), Layout(declared, model)
    act, history = carried_along(one, declared, model)
    count, nv = len(one), declared.nv
    out = {name: np.full((count, nv), np.nan) for name in ("force", "std", "total")}
    full = np.zeros((model.nv, model.nv))
    _sharpened(one, model, place)
    for row in np.flatnonzero(one.usable)[::every]:
        data.qpos[:], data.qvel[:], data.qacc[:] = model.qpos0, 0.0, 0.0
        data.qpos[place.q], data.qvel[place.v] = one.qpos[row], one.qvel[row]
        data.qacc[place.v] = one.qacc[row]
        data.ctrl[:] = one.ctrl[row]
        data.act[:] = act[row]
        if model.nhistory:
            data.history[:] = history[row]
        data.time = one.time[row]
        added = hooked.force(data)
        mujoco.mj_inverse(model, data)
        mujoco.mj_fwdActuation(model, data)
        mujoco.mj_fullM(model, data, full)
        inertia = full[np.ix_(place.v, place.v)]
        out["total"][row] = data.qfrc_inverse[place.v]
        missing = data.qfrc_inverse - data.qfrc_actuator - added
        out["force"][row] = missing[place.v] - one.force[row]
        out["std"][row] = np.sqrt((inertia**2) @ spread[row] ** 2)
    return ForceResidual(one.time, out["force"], out["std"], out["total"])


def _sharpened(one: Samples, model: mujoco.MjModel, place: Layout) -> None:
    """Has dry friction as large as a joint's forces reach its level at a slow speed where it would
    not at the usual one: MuJoCo's inverse dynamics regularises it by the constraint's inverse
    weight (mj_inverse: force = clip(D (b v + a)), D = d / ((1 - d) w)), so that a joint of next to
    no declared inertia would show none.
    """
    usual, pushed = np.zeros(model.nv), np.zeros(model.nv)
    usual[place.v] = np.sqrt(np.nanmean(one.qvel[one.usable] ** 2, axis=0))
    data = mujoco.MjData(model)
    rows = np.flatnonzero(one.usable)
    for row in rows[:: max(1, len(rows) // _ROWS)]:
        data.qpos[place.q], data.qvel[place.v] = one.qpos[row], one.qvel[row]
        data.ctrl[:] = one.ctrl[row]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        data.qfrc_actuator[place.v] += one.force[row]
        pushed += data.qfrc_actuator**2
    pushed = np.sqrt(pushed / max(1, len(rows[:: max(1, len(rows) // _ROWS)])))
    ratio, stiff = model.dof_solimp[:, 0], model.dof_solimp[:, 1]
    constant = np.maximum(model.dof_solref[:, 0], 2 * model.opt.timestep)
    reached = ratio / (1 - ratio) * 2 / (stiff * constant) * usual
    blunt = (pushed > 0) & (reached > 0) & (reached < model.dof_invweight0 * pushed)
    model.dof_invweight0[blunt] = _HARDLY * reached[blunt] / pushed[blunt]


_HARDLY = 0.02
"""Share of a joint's usual speed that is slow."""
_ROWS = 50
"""Samples by which a joint's forces are known well enough."""


class Hooked:
    """What effects that MuJoCo cannot express add in one state.

    Args:
      model: a copy, whose fields they may change.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, hooks = model, hooks_of(model)
        self._runner = HookRunner(model, hooks) if hooks else None
        self._base = {
            name: getattr(model, name).copy()[None]
            for name in (self._runner.fields if self._runner else ())
        }

    def force(self, data: mujoco.MjData) -> Floats:
        """Their generalized force [nv]; controls and model fields are changed in place."""
        model, found = self._model, np.zeros(self._model.nv)
        if self._runner is None:
            return found
        for name, values in self._base.items():
            getattr(model, name)[:] = values[0]
        if self._runner.derived:
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
        if self._runner.derived & ACCELERATION_STAGE:
            mujoco.mj_fwdActuation(model, data)
            mujoco.mj_inverse(model, data)
        none = {
            "qfrc_applied": np.zeros((1, model.nv)),
            "xfrc_applied": np.zeros((1, model.nbody, 6)),
        }
        inputs = self._runner.inputs(
            lambda name: (
                np.atleast_1d(getattr(data, name))[None]
                if name != "time"
                else np.array([data.time])
            ),
            data.ctrl[None],
            none,
            self._base,
        )
        data.ctrl[:] = inputs.ctrl[0]
        for name, values in inputs.fields.items():
            getattr(model, name)[:] = values[0]
        for body in np.flatnonzero(inputs.xfrc[0].any(axis=1)):
            push = inputs.xfrc[0, body]
            mujoco.mj_applyFT(model, data, push[:3], push[3:], data.xipos[body], int(body), found)
        return np.asarray(found + inputs.qfrc[0])
