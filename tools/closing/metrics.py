"""Errors of a scene on held-out recordings; the same code for every scene that is compared."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.force import force_residual
from orbisim.diagnosis.samples import prepare_all
from orbisim.effects import EffectInstance, find
from orbisim.effects.measured import correct
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


def torque_residual(declared: Callable[[], Scene]) -> Metric:
    """RMS of the generalized force that a scene does not account for, by joint.

    Inverse dynamics along the smoothed measured motion; effects without a native MJCF form do not
    count in it.
    """

    def measure(
        scene: Scene, recordings: Sequence[Recording], effects: Sequence[EffectInstance]
    ) -> Scored:
        samples = prepare_all(recordings, declared())
        found = force_residual(samples, scene)
        force = np.concatenate([one.force for one in found])
        rms = np.sqrt(np.nanmean(force**2, axis=0))
        model = declared().model
        names = [model.joint(i).name for i in range(model.njnt)]
        figures = {"all axes": float(np.sqrt(np.sum(rms**2)))}
        figures |= dict(zip(names, map(float, rms), strict=True))
        traces = []
        for one, sample in zip(found, samples, strict=True):
            for axis, name in enumerate(names):
                applied = sample.ctrl[:, axis] * model.actuator_gainprm[axis, 0]
                size = float(np.sqrt(np.nanmean(one.force[:, axis] ** 2)))
                needed = applied + one.force[:, axis]
                traces.append(Trace(f"torque of {name}, N·m", one.time, applied, needed, size))
        return Scored(figures, traces)

    return Metric("torque residual by inverse dynamics, RMS", "N·m", 1.0, measure)


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
