"""A simulated run's own values for the signals that were measured."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.freerun.jobs import Run
from orbisim.physics.mjdata import acceleration_sensors
from orbisim.recording.actuators import actuators
from orbisim.recording.bound import Bound
from orbisim.recording.joints import joints
from orbisim.recording.observed import Signal

Floats = npt.NDArray[np.float64]


def predict(bound: Bound, signals: Sequence[Signal], run: Run) -> list[Floats]:
    """The simulation's values [N, n] of the signals; NaN where they cannot be known."""
    derived = _Derived(bound, run)
    return [
        np.asarray(getattr(run, signal.home)[:, signal.where])
        if signal.home in ("qpos", "qvel")
        else derived.values(signal)
        for signal in signals
    ]


class _Derived:
    """Poses, actuator forces and sensors along a run, by MuJoCo's formulas."""

    def __init__(self, bound: Bound, run: Run) -> None:
        self.bound, self.run, self.model = bound, run, bound.model
        self._fields: dict[str, Floats] = {}

    def values(self, signal: Signal) -> Floats:
        if signal.home == "sensordata":
            return np.asarray(self.sensors()[:, signal.where])
        if signal.home == "torque":
            return np.asarray(self.forces()[:, signal.where])
        return np.asarray(self.along(signal.home)[:, signal.where])

    def along(self, field: str) -> Floats:
        """A field of MjData at every sample; NaN after a divergence."""
        if field not in self._fields:
            self._fields[field] = self._computed(field)
        return self._fields[field]

    def _computed(self, field: str) -> Floats:
        model, run = self.model, self.run
        data = mujoco.MjData(model)
        found = np.full((len(run.time), *getattr(data, field).shape), np.nan)
        ctrl = self.bound.ctrl[run.rows.start : run.rows.stop]
        for row in np.flatnonzero(np.isfinite(run.qpos).all(axis=1)):
            data.qpos[:], data.qvel[:], data.act[:] = run.qpos[row], run.qvel[row], run.act[row]
            data.ctrl[:] = ctrl[row]
            if field in ("xpos", "xquat"):
                mujoco.mj_kinematics(model, data)
            else:
                mujoco.mj_step1(model, data)
                mujoco.mj_fwdActuation(model, data)
            found[row] = getattr(data, field)
        return found

    def forces(self) -> Floats:
        """Forces of the actuators on the joints; NaN where one of them acts with a delay."""
        found = self.along("qfrc_actuator").copy()
        for actuator in actuators(self.model):
            if actuator.joint >= 0 and self.model.actuator_historyadr[actuator.id] >= 0:
                found[:, joints(self.model)[actuator.joint].v] = np.nan
        return found

    def sensors(self) -> Floats:
        """As the backend reports them; else by MuJoCo up to the velocity stage, NaN beyond."""
        if self.run.sensordata is not None and np.isfinite(self.run.sensordata).any():
            return self._delayed(self.run.sensordata, self.run.time - self.run.time[0])
        found = self.along("sensordata").copy()
        found[:, acceleration_sensors(self.model)] = np.nan
        return self._delayed(found, np.zeros(len(found)))

    def _delayed(self, found: Floats, since: Floats) -> Floats:
        """NaN while a delayed sensor still shows what was before the window."""
        model, found = self.model, found.copy()
        for sensor in np.flatnonzero(model.sensor_historyadr >= 0):
            start, width = int(model.sensor_adr[sensor]), int(model.sensor_dim[sensor])
            early = since < float(model.sensor_delay[sensor]) + float(model.opt.timestep)
            found[early, start : start + width] = np.nan
        return found
