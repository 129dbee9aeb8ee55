"""The states from which windows of a recording start."""

from __future__ import annotations

import copy
import dataclasses
import functools
from typing import Literal

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.recording.actuators import actuators
from orbisim.recording.bound import Bound
from orbisim.recording.joints import joints
from orbisim.recording.motion import Motion, estimate_motion
from orbisim.recording.unread import carry_unread
from orbisim.recording.zero_order_hold import Held

Floats = npt.NDArray[np.float64]
Velocities = Literal["recorded", "smoothed"]


@dataclasses.dataclass(frozen=True, eq=False)
class Starts:
    """The state at every row of a recording, as far as it is known.

    Attributes:
      qpos: [T, nq], as recorded; where a sample is missing, smoothed.
      qvel: [T, nv], as recorded; where none is recorded, differentiated and smoothed, at the time
        where the scene's integrator has it. Joints that effects added are carried along.
      notes: which velocities were estimated.
    """

    qpos: Floats
    qvel: Floats
    notes: tuple[str, ...]

    @property
    def usable(self) -> npt.NDArray[np.bool_]:
        """[T]: rows at which the whole state is known."""
        known = np.isfinite(self.qpos).all(axis=1) & np.isfinite(self.qvel).all(axis=1)
        return np.asarray(known)


def starts(
    bound: Bound, velocities: Velocities = "recorded", motion: Motion | None = None
) -> Starts:
    """The state at every row.

    Args:
      bound: the recording in the scene's order.
      velocities: `recorded` uses recorded velocities where there are any; `smoothed` estimates all
        of them from the positions.
      motion: of all joints, where it has been estimated already.
    """
    recorded = bound.qvel if velocities == "recorded" else np.full_like(bound.qvel, np.nan)
    lacking = [
        j
        for j in joints(bound.model)
        if not (np.isfinite(recorded[:, j.v]).all() and np.isfinite(bound.qpos[:, j.q]).all())
    ]
    motion = motion or estimate_motion(bound, {j.id for j in lacking})
    step = float(bound.model.opt.timestep)
    early = motion.qvel - stagger(bound.model) * step * np.nan_to_num(motion.qacc)
    estimated = [j.label for j in lacking if not np.isfinite(recorded[:, j.v]).any()]
    notes = [f"velocities of {', '.join(map(repr, estimated))} are estimated from the positions"]
    qpos, qvel = carry_unread(
        bound,
        np.where(np.isfinite(bound.qpos), bound.qpos, motion.qpos),
        np.where(np.isfinite(recorded), recorded, early),
        functools.partial(_begin, bound),
    )
    return Starts(
        qpos=qpos,
        qvel=qvel,
        notes=tuple(notes if estimated else ()),
    )


def _begin(bound: Bound, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Activations and delay buffers at a state, as after a long time under its controls."""
    if model.na:
        data.act[:] = _settled(model, data)
    if model.nhistory:
        row = np.array([int(np.searchsorted(bound.time, data.time))])
        data.history[:] = histories(bound, row)[0]


def stagger(model: mujoco.MjModel) -> float:
    """By how many steps the velocities of MuJoCo's states belong before their positions.

    Its semi-implicit integrators advance positions with the new velocity: q(k+1) = q(k) + h v(k+1).
    That is the leapfrog scheme with v(k) at the time of q(k) less half a step (Hairer, Lubich and
    Wanner, Geometric Numerical Integration, 2006, section I.1.4), which is second order from there.
    """
    return 0.0 if model.opt.integrator == int(mujoco.mjtIntegrator.mjINT_RK4) else 0.5


def activations(bound: Bound, states: Starts, rows: npt.NDArray[np.int64]) -> Floats:
    """Actuator activations [W, na] at the given rows, in increasing order.

    They are not recorded; they are carried along the recorded motion and controls from the first
    sample, by MuJoCo's own activation dynamics. There, activations that follow the control are
    taken to have reached it, and integrated ones to hold the actuator where it is.
    """
    model = copy.copy(bound.model)
    found = np.zeros((len(rows), model.na))
    if not model.na:
        return found
    flags = mujoco.mjtDisableBit
    for flag in (flags.mjDSBL_CONTACT, flags.mjDSBL_CONSTRAINT, flags.mjDSBL_AUTORESET):
        model.opt.disableflags |= int(flag)
    longest = float(model.opt.timestep)
    data = mujoco.MjData(model)
    known = np.flatnonzero(states.usable)
    _place(data, bound, states, int(known[0]))
    data.act[:] = _settled(model, data)
    wanted = {int(row): index for index, row in enumerate(rows)}
    for row in range(int(rows[-1]) + 1):
        if row in wanted:
            found[wanted[row]] = data.act
        if row + 1 < len(bound.time):
            _carry(model, data, float(bound.time[row + 1] - bound.time[row]), longest)
            _place(data, bound, states, row + 1)
    return found


def _place(data: mujoco.MjData, bound: Bound, states: Starts, row: int) -> None:
    """Puts the recorded motion into `data`; where it is unknown, the last known one stays."""
    data.ctrl[:] = bound.ctrl[row]
    if np.isfinite(states.qpos[row]).all() and np.isfinite(states.qvel[row]).all():
        data.qpos[:], data.qvel[:] = states.qpos[row], states.qvel[row]


def _carry(model: mujoco.MjModel, data: mujoco.MjData, duration: float, longest: float) -> None:
    """Advances the activations; the motion is put back afterwards."""
    count = max(1, int(np.ceil(duration / longest - 1e-6)))
    model.opt.timestep = duration / count
    qpos, qvel = np.array(data.qpos), np.array(data.qvel)
    for _ in range(count):
        mujoco.mj_step(model, data)
        data.qpos[:], data.qvel[:] = qpos, qvel


def _settled(model: mujoco.MjModel, data: mujoco.MjData) -> Floats:
    mujoco.mj_forward(model, data)
    act = np.array(data.act)
    follows = [
        int(kind)
        for kind in (
            mujoco.mjtDyn.mjDYN_FILTER,
            mujoco.mjtDyn.mjDYN_FILTEREXACT,
            mujoco.mjtDyn.mjDYN_MUSCLE,
        )
    ]
    for actuator in actuators(model):
        adr, kind = model.actuator_actadr[actuator.id], model.actuator_dyntype[actuator.id]
        if adr < 0:
            continue
        if kind in follows and actuator.driven:
            act[adr] = data.ctrl[actuator.ctrl.start]
        elif kind == mujoco.mjtDyn.mjDYN_INTEGRATOR:
            act[adr] = data.actuator_length[model.actuator_outadr[actuator.id]]
        if model.actuator_actlimited[actuator.id]:
            act[adr] = np.clip(act[adr], *model.actuator_actrange[actuator.id])
    return act


def histories(bound: Bound, rows: npt.NDArray[np.int64]) -> Floats:
    """Delay buffers [W, nhistory] at the given rows: the recorded controls of the time before.

    Buffers of delayed sensors start empty, at the right time.
    """
    model = bound.model
    found = np.zeros((len(rows), model.nhistory))
    if not model.nhistory:
        return found
    held = Held(bound.time, bound.ctrl)
    data = mujoco.MjData(model)
    for index, row in enumerate(rows):
        now = float(bound.time[row])
        for actuator in np.flatnonzero(model.actuator_historyadr >= 0):
            times = _before(now, model, int(model.actuator_history[actuator, 0]))
            column = int(model.actuator_ctrladr[actuator])
            values = held.at(times + 1e-6 * model.opt.timestep)[:, column]
            mujoco.mj_initCtrlHistory(model, data, int(actuator), times, values)
        for sensor in np.flatnonzero(model.sensor_historyadr >= 0):
            times = _before(now, model, int(model.sensor_history[sensor, 0]))
            values = np.zeros((len(times), int(model.sensor_dim[sensor])))
            mujoco.mj_initSensorHistory(model, data, int(sensor), times, values, times[-1])
        found[index] = data.history
    return found


def _before(now: float, model: mujoco.MjModel, count: int) -> Floats:
    return np.asarray(now - float(model.opt.timestep) * np.arange(count, 0, -1), np.float64)
