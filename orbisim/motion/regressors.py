"""The measured motion with quantities of the model along it."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Literal

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.effects.screening import BodyMotion
from orbisim.motion.hidden import first_order
from orbisim.motion.linear import IntervalMap
from orbisim.motion.samples import Samples
from orbisim.recording.zero_order_hold import Held

Floats = npt.NDArray[np.float64]

_CLIP = 2.2
"""Times the median size, of which a wave's crest is 1.4."""
_PEAKS = 4
"""Frequencies that are proposed: each is a pair of regressors of its own."""


class MotionView:
    """Quantities of a scene's model along the reference motion.

    Args:
      flow: the sampling intervals. samples: the recordings they come from.
      missing_force: [N, nv] generalized force that is missing over each interval.
    """

    def __init__(
        self, flow: IntervalMap, samples: Sequence[Samples], missing_force: Floats | None = None
    ) -> None:
        self.model = flow.model
        self.flow, self.samples = flow, samples
        self.time = np.concatenate([flow.start, flow.start + flow.duration])
        self.qpos = np.concatenate([flow.qpos, flow.after_qpos])
        self.qvel = np.concatenate([flow.qvel, flow.after_qvel])
        self.ctrl = np.concatenate([flow.ctrl, flow.ctrl])
        places = list(zip(flow.recording, flow.row, strict=True))
        acc = [samples[i].qacc[[r, r + 1]] for i, r in places]
        # the declared scene's: the flow's may be of a variant with activations of its own
        self._act = np.array([samples[i].act[r] for i, r in places])
        self._history = np.array([samples[i].history[r] for i, r in places])
        stacked = np.array(acc).reshape(len(flow), 2, self.model.nv)
        self.qacc = np.concatenate([stacked[:, 0], stacked[:, 1]])
        self._walk()
        self.velocity_noise = self._velocity_noise()
        self.missing_force = missing_force

    def _velocity_noise(self) -> Floats:
        """How well the reference velocities are known: position noise over a few intervals."""
        step = float(np.median(self.flow.duration))
        noise = [np.nan_to_num(s.q_noise, nan=0.0) for s in self.samples]
        return np.asarray(np.max(noise, axis=0) / step)

    def _walk(self) -> None:
        model, count = self.model, len(self.time)
        data = mujoco.MjData(model)
        self.actuator_force = np.zeros((count, model.nactuator))
        self.qfrc_actuator = np.zeros((count, model.nv))
        self.qfrc_bias = np.zeros((count, model.nv))
        self.qfrc_constraint = np.zeros((count, model.nv))
        self._moment = np.zeros((count, model.nactuator, model.nv))
        self._states: list[tuple[Floats, ...]] = []
        n = len(self.flow)
        dense = np.zeros((max(model.nactuator, 1), model.nv))
        keep: dict[str, list[Floats]] = {name: [] for name in _KEPT}
        for m in range(count):
            data.qpos[:], data.qvel[:] = self.qpos[m], self.qvel[m]
            data.ctrl[:], data.act[:] = self.ctrl[m], self._act[m % n]
            if model.nhistory:
                data.history[:] = self._history[m % n]
            data.time = self.time[m]
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_fwdActuation(model, data)
            self.actuator_force[m] = data.actuator_force
            self.qfrc_actuator[m] = data.qfrc_actuator
            self.qfrc_bias[m] = data.qfrc_bias
            if data.nefc:
                mujoco.mj_fwdAcceleration(model, data)
                mujoco.mj_fwdConstraint(model, data)
                self.qfrc_constraint[m] = data.qfrc_constraint
            if model.nactuator:
                mujoco.mju_sparse2dense(
                    dense, data.actuator_moment, data.moment_rownnz, data.moment_rowadr,
                    data.moment_colind,
                )  # fmt: skip
                self._moment[m] = dense
            for name in _KEPT:
                keep[name].append(getattr(data, name).copy())
        self._kept = {name: np.array(values) for name, values in keep.items()}

    def moment(self, actuator: int) -> Floats:
        """[M, nv]: generalized force for a unit actuator force."""
        return np.asarray(self._moment[:, actuator])

    def control_gain(self, actuator: int) -> Floats:
        """[M]: derivative of the actuator's force by its control."""
        model = self.model
        prm = model.actuator_gainprm[actuator]
        gain = np.full(len(self.time), float(prm[0]))
        if model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_AFFINE:
            moment = self._moment[:, actuator]
            gain = (
                gain + prm[1] * self._length(actuator) + prm[2] * (moment * self.qvel).sum(axis=1)
            )
        return gain

    def _length(self, actuator: int) -> Floats:
        return np.asarray(self._kept["actuator_length"][:, actuator])

    def filtered_control(self, control: int, time_constant: float) -> Floats:
        """[M]: the control after a first-order filter, exact for a held control."""
        per_row = []
        for one in self.samples:
            per_row.append(first_order(one.time, one.ctrl[:, control], time_constant))
        return self._at_ends(per_row)

    def delayed_control(self, control: int, delay: float) -> Floats:
        """[M]: the control of some time before; at an interval's ends its mean over it."""
        starts, ends = [], []
        for i, r in self._by_recording():
            one = self.samples[i]
            held = Held(one.time, one.ctrl[:, [control]])
            begin, stop = one.time[r] - delay, one.time[r + 1] - delay
            fine = begin[:, None] + (stop - begin)[:, None] * (np.arange(8) + 0.5) / 8
            mean = held.at(fine.ravel())[:, 0].reshape(fine.shape).mean(axis=1)
            starts.append(mean)
            ends.append(mean)
        return np.concatenate([*starts, *ends])

    def _by_recording(self) -> list[tuple[int, npt.NDArray[np.int64]]]:
        flow = self.flow
        return [
            (i, flow.row[flow.recording == i])
            for i in range(len(self.samples))
            if (flow.recording == i).any()
        ]

    def _at_ends(self, per_row: list[Floats]) -> Floats:
        flow = self.flow
        starts = np.array([per_row[i][r] for i, r in zip(flow.recording, flow.row, strict=True)])
        ends = np.array([per_row[i][r + 1] for i, r in zip(flow.recording, flow.row, strict=True)])
        return np.concatenate([starts, ends])

    @functools.cache  # noqa: B019 (lives as long as the diagnosis)
    def body_motion(self, body: int) -> BodyMotion:
        """Velocity, acceleration and Jacobians of a body along the motion."""
        model, count = self.model, len(self.time)
        data = mujoco.MjData(model)
        jac = {name: np.zeros((count, 3, model.nv)) for name in ("com", "origin", "spin")}
        acc = np.zeros((count, 6))
        for m in range(count):
            data.qpos[:], data.qvel[:], data.qacc[:] = self.qpos[m], self.qvel[m], self.qacc[m]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            mujoco.mj_jacBodyCom(model, data, jac["com"][m], None, body)
            mujoco.mj_jacBody(model, data, jac["origin"][m], jac["spin"][m], body)
            mujoco.mj_rnePostConstraint(model, data)
            mujoco.mj_objectAcceleration(
                model, data, mujoco.mjtObj.mjOBJ_XBODY, body, acc[m], False
            )
        spin = np.einsum("mij,mj->mi", jac["spin"], self.qvel)
        return BodyMotion(
            com=self._kept["xipos"][:, body],
            spin=spin,
            velocity=np.einsum("mij,mj->mi", jac["com"], self.qvel),
            rotation=self._kept["xmat"][:, body].reshape(count, 3, 3),
            origin=self._kept["xpos"][:, body],
            jac_com=jac["com"],
            jac_origin=jac["origin"],
            jac_spin=jac["spin"],
            acc_origin=acc[:, 3:],
            spin_acc=acc[:, :3],
        )

    def spectrum_peaks(self, dof: int, against: Literal["time", "position"]) -> Floats:
        """Frequencies that stand out in the missing force (Lomb-Scargle)."""
        if self.missing_force is None:
            return np.zeros(0)
        n = len(self.flow)
        force = self.missing_force[:, dof]
        good = np.isfinite(force)
        x = self.time[:n] if against == "time" else self._angle(dof)[:n]
        grid = _frequency_grid(x[good], against)
        if not grid.size or good.sum() < 16:
            return np.zeros(0)
        scale = 2 * np.pi if against == "time" else 1.0
        return _peaks(scale * x[good], force[good], grid)

    def _angle(self, dof: int) -> Floats:
        joint = int(self.model.dof_jntid[dof])
        return np.asarray(self.qpos[:, int(self.model.jnt_qposadr[joint])])


_KEPT = ("xipos", "xpos", "xmat", "actuator_length")


def _frequency_grid(x: Floats, against: str) -> Floats:
    """Frequencies (Hz) or periods for each turn that the data can resolve."""
    if not len(x):
        return np.zeros(0)
    spread = float(x.max() - x.min())
    if against == "time":
        step = float(np.median(np.abs(np.diff(x)))) or 1.0
        top = min(0.5 / step, 60.0)
        longest = min(spread, 20.0)
        return np.arange(0.5 / longest, top, 0.25 / longest) if spread > 0 else np.zeros(0)
    if spread <= 0:
        return np.zeros(0)
    lowest = 2 * np.pi / spread  # a whole period within the travel
    resolution = max(0.25 * min(lowest, 1.0), lowest / _FINEST)
    return np.arange(max(lowest, resolution), max(60.0, 40 * lowest), resolution)


_FINEST = 64.0
"""Steps within what the travel resolves: a joint that hardly moves resolves next to nothing."""


def _peaks(x: Floats, y: Floats, grid: Floats) -> Floats:
    """The strongest angular frequencies, apart from each other. What is far off counts no more than
    what is a little off: a few impacts would outweigh a wave."""
    y = y - np.median(y)
    most = _CLIP * float(np.median(np.abs(y)))
    y = np.clip(y, -most, most) if most > 0 else y
    y = y - y.mean()
    power = np.empty(len(grid))
    for i, frequency in enumerate(grid):
        phase = frequency * x
        basis = np.stack([np.sin(phase), np.cos(phase)])
        gram = basis @ basis.T + 1e-9 * len(x) * np.eye(2)
        moment = basis @ y
        power[i] = moment @ np.linalg.solve(gram, moment)
    order = np.argsort(-power)
    chosen: list[float] = []
    gap = 4 * float(grid[1] - grid[0]) if len(grid) > 1 else 0.0
    for i in order:
        if all(abs(grid[i] - other) > gap for other in chosen):
            chosen.append(float(grid[i]))
        if len(chosen) == _PEAKS:
            break
    return np.array(chosen)
