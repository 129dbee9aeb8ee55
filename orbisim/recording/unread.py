"""The state of joints that effects have added and no encoder reads, estimated along a recording.

An extended Kalman filter over all positions and velocities (Anderson and Moore, Optimal Filtering,
1979, section 8.2): MuJoCo predicts the state over each sampling interval and gives its derivatives
(`mjd_transitionFD`); the joints that are read correct it. The estimate at a sample uses that sample
and those before it only, so that a free run from there is still a prediction.
"""

from __future__ import annotations

import copy
from collections.abc import Callable

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.recording.bound import Bound
from orbisim.recording.joints import Joint, joints
from orbisim.recording.noise import noise_std
from orbisim.scene.hidden import hidden_joints

Floats = npt.NDArray[np.float64]

_ROUNDS = 20
"""In which springs come to rest at the start, at most."""
_EPS = 1e-6
"""Step of finite differences: rad, m, and these per second."""
_MODEL_ERROR = 0.02
"""Share of the motion by which the scene itself may be wrong, in each step."""
_PLAY = 0.05
"""rad or m: standard deviation of where a joint that is not recorded is at the start."""
_GATE = 5.0
"""Standard deviations; a larger surprise moves the state as this one would."""


Begin = Callable[[mujoco.MjModel, mujoco.MjData], None]


def carry_unread(bound: Bound, qpos: Floats, qvel: Floats, begin: Begin) -> tuple[Floats, Floats]:
    """Fills the hidden joints' columns of the states at all samples; the others stay.

    It starts in static equilibrium at the first sample: springs bent by gravity, play at the end
    where gravity holds it. Effects that MuJoCo cannot express are left out of the prediction.

    Args:
      bound: the recording. qpos: [T, nq]. qvel: [T, nv]; NaN where unknown.
      begin: sets the activations and delay buffers of the first sample.
    """
    names = hidden_joints(bound.model)
    hidden = [j for j in joints(bound.model) if j.name in names and not _recorded(bound, j)]
    rows = np.flatnonzero(np.isfinite(qpos).all(axis=1) & np.isfinite(qvel).all(axis=1))
    if not hidden or len(rows) < 3:
        return qpos, qvel
    return _Filter(bound, hidden, rows, qpos.copy(), qvel.copy()).run(begin)


def _recorded(bound: Bound, joint: Joint) -> bool:
    """Whether a joint that an effect added is in the recording all the same."""
    return f"qpos/{joint.name}" in bound.recording.signals


class _Filter:
    def __init__(
        self,
        bound: Bound,
        hidden: list[Joint],
        rows: npt.NDArray[np.int64],
        qpos: Floats,
        qvel: Floats,
    ) -> None:
        self.bound, self.hidden, self.rows = bound, hidden, rows
        self.qpos, self.qvel = qpos, qvel
        self.model = _driven(bound)
        self.data, self.trial = mujoco.MjData(self.model), mujoco.MjData(self.model)
        self.longest = float(self.model.opt.timestep)
        nv = self.model.nv
        unread = np.zeros(nv, bool)
        unread[[j.v.start for j in hidden]] = True
        self.hidden_q = np.array([j.q.start for j in hidden])
        self.hidden_v = np.flatnonzero(unread)
        self.read = np.flatnonzero(~np.concatenate([unread, unread]))
        self.noise = np.diag(self._read_noise()[self.read])
        self.process = self._process()

    def _read_noise(self) -> Floats:
        """Variance of the recorded positions and velocities of every degree of freedom, [2 nv]."""
        time, found = self.bound.time[self.rows], np.ones(2 * self.model.nv)
        for joint in joints(self.model):
            width = joint.v.stop - joint.v.start
            place = self.qpos[self.rows][:, joint.q]
            level = max(float(np.sqrt(np.mean(noise_std(time, place) ** 2))), 1e-9)
            rates = self.qvel[self.rows][:, joint.v]
            speed = max(float(np.sqrt(np.mean(noise_std(time, rates) ** 2))), 1e-7)
            found[joint.v] = np.full(width, level**2)
            found[self.model.nv + joint.v.start : self.model.nv + joint.v.stop] = speed**2
        return found

    def _process(self) -> Floats:
        """[nv]: how fast the variance of each velocity grows as the scene is not quite right, 1/s:
        a small part of the accelerations, as white noise over a sampling interval."""
        step = float(np.median(np.diff(self.bound.time[self.rows])))
        acc = np.diff(self.qvel[self.rows], axis=0) / step
        size = np.sqrt(np.median(acc**2, axis=0))
        size[self.hidden_v] = size.max()
        return np.asarray((_MODEL_ERROR * size) ** 2 * step)

    def run(self, begin: Begin) -> tuple[Floats, Floats]:
        data, nv = self.data, self.model.nv
        first = int(self.rows[0])
        data.qpos[:], data.qvel[:] = self.qpos[first], self.qvel[first]
        data.ctrl[:] = self.bound.ctrl[first]
        data.time = self.bound.time[first]
        begin(self.model, data)
        self._settle()
        spread = np.zeros((2 * nv, 2 * nv))
        spread[np.ix_(self.read, self.read)] = self.noise
        start = [_PLAY**2] * len(self.hidden_v)
        spread[self.hidden_v, self.hidden_v] = start
        speed = np.median(self.qvel[self.rows] ** 2)
        spread[nv + self.hidden_v, nv + self.hidden_v] = max(float(speed), 1e-6)
        for k, row in enumerate(self.rows):
            if k:
                spread = self._predict(int(self.rows[k - 1]), int(row), spread)
                spread = self._correct(int(row), spread)
            self.qpos[row, self.hidden_q] = data.qpos[self.hidden_q]
            self.qvel[row, self.hidden_v] = data.qvel[self.hidden_v]
        return self.qpos, self.qvel

    def _predict(self, before: int, row: int, spread: Floats) -> Floats:
        """Advances the state and its covariance to the next sample."""
        model, data, nv = self.model, self.data, self.model.nv
        duration = float(self.bound.time[row] - self.bound.time[before])
        count = max(1, int(np.ceil(duration / self.longest - 1e-6)))
        model.opt.timestep = duration / count
        data.ctrl[:] = self.bound.ctrl[before]
        force = np.nan_to_num(self.bound.torque[before])
        data.qfrc_applied[:] = np.where(self.bound.applied, force, 0.0)
        every = np.eye(2 * nv)
        for _ in range(count):
            every = self._transition() @ every
            mujoco.mj_step(model, data)
        if not (np.isfinite(data.qpos).all() and np.isfinite(every).all()):
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = self.qpos[row], self.qvel[row]
            return spread
        with np.errstate(all="ignore"):
            grown = every @ spread @ every.T
        if not np.isfinite(grown).all():  # so unstable a scene that nothing is known from before
            return spread
        grown = 0.5 * (grown + grown.T)
        grown[range(nv, 2 * nv), range(nv, 2 * nv)] += self.process * duration
        return np.asarray(grown)

    def _transition(self) -> Floats:
        """[2 nv, 2 nv]: derivatives of the next state by this one; what is in delay buffers, which
        `mjd_transitionFD` does not support, stays as it is."""
        model, nv = self.model, self.model.nv
        size = 2 * nv + model.na
        found = np.zeros((size, size))
        if not model.nhistory:
            mujoco.mjd_transitionFD(model, self.data, _EPS, False, found, None, None, None)
            return found[: 2 * nv, : 2 * nv]
        base = self._stepped(np.zeros(2 * nv))
        for column in range(2 * nv):
            moved = self._stepped(_EPS * np.eye(2 * nv)[column])
            change = np.zeros(nv)
            mujoco.mj_differentiatePos(model, change, _EPS, base[: model.nq], moved[: model.nq])
            found[:nv, column] = change
            found[nv : 2 * nv, column] = (moved[model.nq :] - base[model.nq :]) / _EPS
        return found[: 2 * nv, : 2 * nv]

    def _stepped(self, move: Floats) -> Floats:
        """Positions and velocities [nq + nv] a timestep after the state moved by [2 nv]."""
        model, nv, data = self.model, self.model.nv, self.trial
        mujoco.mj_copyData(data, model, self.data)
        mujoco.mj_integratePos(model, data.qpos, move[:nv], 1.0)
        data.qvel[:] += move[nv:]
        mujoco.mj_step(model, data)
        return np.concatenate([data.qpos, data.qvel])

    def _correct(self, row: int, spread: Floats) -> Floats:
        """Moves the state towards what was read."""
        model, data, nv, read = self.model, self.data, self.model.nv, self.read
        off = np.zeros(nv)
        mujoco.mj_differentiatePos(model, off, 1.0, data.qpos, self.qpos[row])
        surprise = np.concatenate([off, self.qvel[row] - data.qvel])[read]
        expected = spread[np.ix_(read, read)] + self.noise
        scale = np.sqrt(np.maximum(np.diag(expected), np.diag(self.noise)))
        inverse = np.linalg.pinv(expected / np.outer(scale, scale), hermitian=True)
        inverse /= np.outer(scale, scale)
        gain = spread[:, read] @ inverse
        with np.errstate(all="ignore"):
            size = float(np.sqrt(max(surprise @ inverse @ surprise / len(read), 0.0)))
        move = gain @ surprise * min(1.0, _GATE / max(size, 1e-12))
        mujoco.mj_integratePos(model, data.qpos, move[:nv], 1.0)
        data.qvel[:] += move[nv:]
        keep = np.eye(2 * nv)
        keep[:, read] -= gain
        return keep @ spread @ keep.T + gain @ self.noise @ gain.T

    def _settle(self) -> None:
        """Puts the hidden joints where gravity holds them."""
        model, data = self.model, self.data
        moving = np.array(data.qvel)
        data.qvel[:] = 0.0
        for _ in range(_ROUNDS):
            mujoco.mj_forward(model, data)
            for joint in self.hidden:
                load = -float(data.qfrc_bias[joint.v.start])
                stiffness = float(np.ravel(model.jnt_stiffness[joint.id])[0])
                if stiffness:
                    rest = float(model.qpos_spring[joint.q.start])
                    data.qpos[joint.q.start] = rest + load / stiffness
                elif model.jnt_limited[joint.id]:
                    data.qpos[joint.q.start] = model.jnt_range[joint.id][int(load > 0)]
        data.qvel[:] = moving


def _driven(bound: Bound) -> mujoco.MjModel:
    """The model, without the actuators that recorded forces stand for."""
    model, off = copy.copy(bound.model), list(bound.switched_off)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    if off:
        model.actuator_gaintype[off] = int(mujoco.mjtGain.mjGAIN_FIXED)
        model.actuator_biastype[off] = int(mujoco.mjtBias.mjBIAS_NONE)
        model.actuator_gainprm[off] = model.actuator_biasprm[off] = 0.0
    return model
