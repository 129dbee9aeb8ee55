"""What sensors should have read along a measured motion, next to what they did.

Where the scene (with what was found) predicts the motion to within the noise, its own free runs
from estimated starts give the readings; elsewhere the smoothed motion does, with forces by inverse
dynamics, so that a force that the scene lacks does not look like a fault of a sensor.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.effects.base import AXES
from orbisim.motion.force import Hooked
from orbisim.motion.hidden import Layout, carried_along
from orbisim.motion.samples import Samples
from orbisim.recording import estimate_motion
from orbisim.recording.sensors import Sensor, reads_state, sensors
from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]

_UNPREDICTABLE = frozenset({"TOUCH", "CONTACT", "USER", "PLUGIN", "CLOCK", "TACTILE"})
# readings of a sensor below which its noise is not known
_FEWEST = 30
_ACCELERATION = int(mujoco.mjtStage.mjSTAGE_ACC)


@dataclasses.dataclass(frozen=True, eq=False)
class Readings:
    """Of one recording.

    Attributes:
      time: [T], s. measured, expected: [T, nsensordata]; NaN where unknown.
      spread: [nsensordata] standard deviation of what is expected, by the motion's own uncertainty.
    """

    time: Floats
    measured: Floats
    expected: Floats
    spread: Floats


def usable_sensors(samples: Sequence[Samples], notes: list[str]) -> list[Sensor]:
    """Recorded sensors whose readings follow from the motion and are no part of it already."""
    model, found = samples[0].bound.model, []
    for one in sensors(model):
        seen = sum(
            int(np.isfinite(s.bound.sensordata[:, one.place]).all(axis=1).sum()) for s in samples
        )
        if not seen:
            continue
        why = None
        if one.kind in _UNPREDICTABLE:
            why = f"readings of kind {one.kind.lower()} do not follow from the motion"
        elif one.rotation:
            why = "it reads an orientation"
        elif one.delayed:
            why = "the scene gives it a delay"
        elif not one.name:
            why = "it has no name"
        elif one.width > len(AXES):
            why = f"it has {one.width} components"
        elif seen < _FEWEST:
            why = f"{seen} readings are too few"
        if why is None and not all(_apart(s, one) for s in samples):
            continue  # it is the joint's own signal
        if why is None:
            found.append(one)
        else:
            notes.append(f"sensor {one.label!r} is not looked at: {why}")
    return found


def _apart(sample: Samples, one: Sensor) -> bool:
    """Whether a sensor is not itself where the motion is known from."""
    reads = reads_state(sample.bound.model, one)
    if reads is None:
        return True
    kind, target = reads
    signals = sample.bound.recording.signals
    model = sample.bound.model
    name = (model.joint if kind in ("qpos", "qvel") else model.body)(target).name
    return kind in signals or f"{kind}/{name}" in signals


def smoothed_readings(samples: Sequence[Samples], scene: Scene) -> list[Readings]:
    """Expected readings along the smoothed motion, by inverse dynamics.

    Args:
      scene: the declared scene, perhaps with effects added. Joints that an effect added rest.
    """
    return [_along(one, scene) for one in samples]


def _along(one: Samples, scene: Scene) -> Readings:
    motion = estimate_motion(one.bound)
    rng = np.random.default_rng(0)
    exact = _Reader(one, scene)
    rows = [int(row) for row in np.flatnonzero(one.usable)]
    expected = np.full((len(one), scene.model.nsensordata), np.nan)
    moved = expected.copy()
    for row in rows:
        state = one.qpos[row], one.qvel[row], one.qacc[row]
        expected[row] = exact.at(row, *state)
        other = [
            values + np.nan_to_num(std[row]) * rng.standard_normal(one.qvel.shape[1])
            for values, std in zip(
                (np.zeros(one.qvel.shape[1]), *state[1:]),
                (motion.qpos_std, motion.qvel_std, motion.qacc_std),
                strict=True,
            )
        ]
        qpos = state[0].copy()
        mujoco.mj_integratePos(one.bound.model, qpos, other[0], 1.0)
        moved[row] = exact.at(row, qpos, other[1], other[2])
    spread = np.sqrt(np.nanmean((moved - expected) ** 2, axis=0))
    return Readings(one.time, one.bound.sensordata, expected, spread)


@dataclasses.dataclass(frozen=True, eq=False)
class FreeRun:
    """A window of a recording as a scene runs through it.

    Attributes:
      recording: number of the recording. row: at which it starts.
      qpos: [K, nq], qvel: [K, nv], in the coordinates of the declared scene.
    """

    recording: int
    row: int
    qpos: Floats
    qvel: Floats


def simulated_readings(
    samples: Sequence[Samples], scene: Scene, runs: Sequence[FreeRun]
) -> list[Readings]:
    """Expected readings along free runs.

    Args:
      scene: that ran.
    """
    found = []
    for i, one in enumerate(samples):
        reader = _Reader(one, scene)
        total = np.zeros((len(one), scene.model.nsensordata))
        square, count = total.copy(), np.zeros(len(one))
        for run in (run for run in runs if run.recording == i):
            for row, (qpos, qvel) in enumerate(zip(run.qpos, run.qvel, strict=True), run.row):
                values = reader.at(row, qpos, qvel, None)
                total[row] += values
                square[row] += values**2
                count[row] += 1
        mean = total / np.where(count > 0, count, np.nan)[:, None]
        twice = count == 2  # where one window ends and the next begins
        apart = np.maximum(square[twice] / 2 - mean[twice] ** 2, 0.0)
        spread = np.sqrt(apart.mean(axis=0)) if twice.any() else np.zeros(total.shape[1])
        found.append(Readings(one.time, one.bound.sensordata, mean, spread))
    return found


class _Reader:
    """MuJoCo's sensors in single states of a recording."""

    def __init__(self, one: Samples, scene: Scene) -> None:
        self._one, self._model = one, copy.copy(scene.model)
        self._hooked = Hooked(self._model)
        self._data = mujoco.MjData(self._model)
        self._place = Layout(one.bound.model, self._model)
        self._act, self._history = carried_along(one, one.bound.model, self._model)
        stages = [s.place for s in sensors(self._model) if s.stage == _ACCELERATION]
        self._late = np.concatenate(
            [np.arange(p.start, p.stop) for p in stages] or [np.zeros(0, int)]
        )

    def at(self, row: int, qpos: Floats, qvel: Floats, qacc: Floats | None) -> Floats:
        """Readings [nsensordata]; with accelerations given by inverse dynamics, else by the scene's
        own. Those that depend on forces are NaN in contact."""
        model, data, place, one = self._model, self._data, self._place, self._one
        data.qpos[:], data.qvel[:] = model.qpos0, 0.0
        data.qpos[place.q], data.qvel[place.v] = qpos, qvel
        data.ctrl[:], data.act[:] = one.ctrl[row], self._act[row]
        if model.nhistory:
            data.history[:] = self._history[row]
        data.time = one.time[row]
        data.qfrc_applied[:] = 0.0
        added = self._hooked.force(data)
        added[place.v] += one.force[row]
        if qacc is None:
            data.qfrc_applied[:] = added
            mujoco.mj_forward(model, data)
        else:
            data.qacc[:] = 0.0
            data.qacc[place.v] = qacc
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_fwdActuation(model, data)
            mujoco.mj_inverse(model, data)
            mujoco.mj_sensorAcc(model, data)
        values = np.array(data.sensordata)
        if data.ncon:
            values[self._late] = np.nan
        return values
