"""Errors of a scene on held-out recordings; the same code for every scene that is compared."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.signal import butter, sosfiltfilt

from orbisim.effects import EffectInstance, find
from orbisim.effects.measured import correct
from orbisim.motion.force import Hooked
from orbisim.motion.hidden import Layout
from orbisim.recording import Recording
from orbisim.recording.initial import Velocities
from orbisim.replay import Replay, replay
from orbisim.scene import Scene
from orbisim.scores import Window

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Trace:
    """A stretch to draw. label: of the quantity, with unit. time [N], measured [N], simulated [N].

    Attributes:
      error: of the whole stretch, by which a typical one is chosen.
    """

    label: str
    time: Floats
    measured: Floats
    simulated: Floats
    error: float


@dataclasses.dataclass(frozen=True, eq=False)
class Scored:
    """figures: errors by name, the first one is the headline. traces: every stretch."""

    figures: Mapping[str, float]
    traces: Sequence[Trace]


Measure = Callable[[Scene, Sequence[Recording], Sequence[EffectInstance]], Scored]


@dataclasses.dataclass(frozen=True)
class Metric:
    """words: what is measured. unit, factor: of the table, and SI times factor is in that unit."""

    words: str
    unit: str
    factor: float
    measure: Measure


def free_run(
    window: float, unit: str = "rad", factor: float = 1.0, velocities: Velocities = "recorded"
) -> Metric:
    """RMS error of the joint positions in windows that start at the measured state."""

    def measure(
        scene: Scene, recordings: Sequence[Recording], effects: Sequence[EffectInstance]
    ) -> Scored:
        run = _run(scene, recordings, effects, window, velocities)
        figures = {"all": run.rms}
        if len(run.positions) > 1:
            figures |= {name.removeprefix("qpos/"): run.signals[name].rms for name in run.positions}
        elif len(recordings) > 1:
            for number, one in enumerate(recordings):
                own = [w for w in run.windows if w.recording == number]
                weights = [len(w.time) for w in own]
                square = np.average([w.rms**2 for w in own], weights=weights)
                figures[Path(one.source).stem] = float(np.sqrt(square))
        return Scored(figures, [_trace(w, run, w.rms) for w in run.windows])

    return Metric(f"free run over windows of {window:g} s, RMS", unit, factor, measure)


def position_after(seconds: float) -> Metric:
    """Median distance of the position some time after the start."""

    def rows(one: Recording) -> int:
        return int(np.searchsorted(one.time - one.time[0], seconds))

    return _at(f"position {seconds:g} s after the start, median", rows)


def end_of_run() -> Metric:
    """Median distance of the position at the last sample."""
    return _at("position at the last sample, median", lambda one: len(one) - 1)


def _at(words: str, row: Callable[[Recording], int]) -> Metric:
    def measure(
        scene: Scene, recordings: Sequence[Recording], effects: Sequence[EffectInstance]
    ) -> Scored:
        run = _run(scene, recordings, effects, 0.0)
        name, far, traces = run.positions[0], [], []
        for window in run.windows:
            last = row(recordings[window.recording])
            if last < len(window.time):
                far.append(float(window.error[name][last]))
                traces.append(_trace(window, run, far[-1], last + 1))
        figures = {"median": float(np.median(far)), "95 %": float(np.percentile(far, 95))}
        return Scored(figures | {"mean": float(np.mean(far))}, traces)

    return Metric(words, "mm", 1e3, measure)


def torque_residual(
    declared: Callable[[], Scene], cutoff: float, only: Sequence[str] = ()
) -> Metric:
    """RMS of the generalized force that a scene does not account for, by joint.

    Inverse dynamics along the motion below some frequency: positions and torques pass the same
    zero-phase filter (Butterworth, fourth order, forwards and backwards).

    Args:
      declared: loads the scene as declared. cutoff: of the filter, Hz.
      only: the joints that count; all if empty.
    """

    def measure(
        scene: Scene, recordings: Sequence[Recording], effects: Sequence[EffectInstance]
    ) -> Scored:
        model = declared().model
        names = [model.joint(i).name for i in range(model.njnt)]
        axes = [i for i, name in enumerate(names) if not only or name in only]
        motions = [_filtered(one, names, model, cutoff) for one in recordings]
        missing = [_missing(scene, one, model) for one in motions]
        rms = np.sqrt(np.mean(np.concatenate(missing) ** 2, axis=0))
        figures = {"all axes": float(np.sqrt(np.sum(rms[axes] ** 2)))}
        figures |= {names[i]: float(rms[i]) for i in axes}
        traces = []
        for one, left in zip(motions, missing, strict=True):
            for axis in axes:
                motor = list(model.actuator_trnid[:, 0]).index(axis)
                applied = one.ctrl[:, motor] * model.actuator_gainprm[motor, 0]
                size = float(np.sqrt(np.mean(left[:, axis] ** 2)))
                label = f"torque of {names[axis]}, N·m"
                traces.append(Trace(label, one.time, applied, applied + left[:, axis], size))
        return Scored(figures, traces)

    return Metric(
        f"torque residual by inverse dynamics below {cutoff:g} Hz, RMS", "N·m", 1.0, measure
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Motion:
    """time [T], s. qpos, qvel, qacc: [T, nv]. ctrl: [T, nu]; all filtered."""

    time: Floats
    qpos: Floats
    qvel: Floats
    qacc: Floats
    ctrl: Floats


def _filtered(
    one: Recording, names: Sequence[str], model: mujoco.MjModel, cutoff: float
) -> _Motion:
    """The motion below a frequency, without the first and last 5 %, where a filter is not sure."""
    step = float(np.median(np.diff(one.time)))
    time = np.arange(one.time[0], one.time[-1], step)
    sections = butter(4, 2 * cutoff * step, output="sos")

    def smooth(name: str) -> Floats:
        values = one[name].reshape(len(one))
        return np.asarray(sosfiltfilt(sections, np.interp(time, one.time, values)))

    motors = [model.actuator(i).name for i in range(model.nu)]
    qpos = np.stack([smooth(f"qpos/{name}") for name in names], axis=1)
    ctrl = np.stack([smooth(f"ctrl/{name}") for name in motors], axis=1)
    qvel = np.gradient(qpos, step, axis=0)
    qacc = np.gradient(qvel, step, axis=0)
    edge = slice(len(time) // 20, -(len(time) // 20))
    return _Motion(time[edge], qpos[edge], qvel[edge], qacc[edge], ctrl[edge])


def _missing(scene: Scene, motion: _Motion, declared: mujoco.MjModel) -> Floats:
    """[T, nv]: the force that a scene, with the effects that it carries, lacks along a motion, at
    the declared joints. What an effect adds as a joint (play, an elastic transmission) no recording
    shows: it stays where it is declared."""
    model = copy.copy(scene.model)
    data, hooked, place = mujoco.MjData(model), Hooked(model), Layout(declared, model)
    found = np.zeros_like(motion.qpos)
    for row in range(len(found)):
        data.qpos[:], data.qvel[:], data.qacc[:] = model.qpos0, 0.0, 0.0
        data.qpos[place.q], data.qvel[place.v] = motion.qpos[row], motion.qvel[row]
        data.qacc[place.v], data.ctrl[:] = motion.qacc[row], motion.ctrl[row]
        added = hooked.force(data)
        mujoco.mj_inverse(model, data)
        mujoco.mj_fwdActuation(model, data)
        found[row] = (data.qfrc_inverse - data.qfrc_actuator - added)[place.v]
    return found


def best_start(window: float, unit: str = "rad", factor: float = 1.0) -> Metric:
    """RMS error of the joint positions in windows that start where that leaves least.

    For positions alone, whose derivative is a poor start. Of hinges and slides.
    """

    def measure(
        scene: Scene, recordings: Sequence[Recording], effects: Sequence[EffectInstance]
    ) -> Scored:
        run = _run(scene, recordings, effects, window, "smoothed")
        traces = []
        for w in run.windows:
            fitted = _from_best_start(scene, recordings[w.recording].rows(slice(w.start, w.stop)))
            name = run.positions[0]
            measured = w.measured[name][:, 0]
            error = float(np.sqrt(np.mean((fitted - measured) ** 2)))
            label = f"{name.partition('/')[2]}, {run.signals[name].unit}"
            traces.append(Trace(label, w.time, measured, fitted, error))
        weights = [len(one.time) for one in traces]
        square = np.average([one.error**2 for one in traces], weights=weights)
        return Scored({"all": float(np.sqrt(square))}, traces)

    return Metric(
        f"free run over windows of {window:g} s from the best start, RMS", unit, factor, measure
    )


def _from_best_start(scene: Scene, recording: Recording) -> Floats:
    """[T]: the first position of the run of one joint that fits its recording best."""
    name = next(n for n in recording.signals if n.startswith("qpos/"))
    measured = recording[name].reshape(len(recording))
    at_rest = np.zeros(len(measured))
    first = np.polyfit(recording.time - recording.time[0], measured, 3)[::-1]

    def positions(start: Floats) -> Floats:
        begun, speed = measured.copy(), at_rest.copy()
        begun[0], speed[0] = start
        signals = {**recording.signals, name: begun, name.replace("qpos", "qvel"): speed}
        run = replay(scene, [recording.replace(signals=signals)], window=0)
        return np.asarray(run.windows[0].qpos[:, 0])

    found = least_squares(lambda start: positions(start) - measured, first[:2], x_scale="jac")
    return positions(found.x)


def _run(
    scene: Scene,
    recordings: Sequence[Recording],
    effects: Sequence[EffectInstance],
    window: float,
    velocities: Velocities = "recorded",
) -> Replay:
    """A free run; effects on the measurement are taken out of the recordings first."""
    measuring = [one for one in effects if find(one.effect).measurement]
    if measuring:
        recordings = [correct(one, measuring, scene) for one in recordings]
    return replay(scene, list(recordings), window=window, velocities=velocities)


def _trace(window: Window, run: Replay, error: float, stop: int | None = None) -> Trace:
    """The signal, and its column, that moves most in a window."""
    moved = {
        (name, column): float(np.nanstd(window.measured[name][:stop, column]))
        for name in run.positions
        for column in range(window.measured[name].shape[1])
    }
    name, column = max(moved, key=lambda key: moved[key])
    axis = f" {'xyz'[column]}" if window.measured[name].shape[1] == 3 else ""
    joint = name.partition("/")[2]
    return Trace(
        f"{joint}{axis}, {run.signals[name].unit}",
        window.time[:stop],
        window.measured[name][:stop, column],
        window.simulated[name][:stop, column],
        error,
    )
