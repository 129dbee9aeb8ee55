"""Errors of simulated windows against recordings."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.freerun import Prepared, Run
from orbisim.freerun.predict import predict
from orbisim.recording.bound import Bound
from orbisim.recording.observed import Signal, observed

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class SignalError:
    """Error of one signal over all samples of all windows, in `unit`.

    Attributes:
      unit: SI; rotations in rad.
      rms: root mean square of the error (of its norm for vectors, its angle for rotations).
      median, p95: of the size of the error.
      noise: standard deviation of the measurement noise, estimated from the recording.
    """

    unit: str
    rms: float
    median: float
    p95: float
    noise: float


@dataclasses.dataclass(frozen=True, eq=False)
class Window:
    """One window.

    Attributes:
      recording: number of the recording. start, stop: its rows start, ..., stop - 1.
      time: [N], s. qpos: [N, nq], qvel: [N, nv] simulated at the recorded times.
      measured, simulated: samples of each signal [N, n]; NaN where they are not known.
      error: size of the error of each signal [N], NaN where a sample is missing.
      rms: root mean squared norm of the error over joint positions.
      diverged: whether the simulation became non-finite; its errors are infinite from there on.
    """

    recording: int
    start: int
    stop: int
    time: Floats
    qpos: Floats
    qvel: Floats
    measured: Mapping[str, Floats]
    simulated: Mapping[str, Floats]
    error: Mapping[str, Floats]
    rms: float
    diverged: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Scores:
    """Errors of all windows.

    Attributes:
      windows: each with its own errors. signals: errors by signal.
      positions: names of the signals that are joint positions.
      rms: root mean squared norm of the error over joint positions.
    """

    windows: tuple[Window, ...]
    signals: Mapping[str, SignalError]
    positions: tuple[str, ...]
    rms: float


def score(prepared: Sequence[Prepared], runs: Sequence[Run]) -> Scores:
    """Compares simulated windows with the recordings that they belong to."""
    signals = [observed(one.bound) for one in prepared]
    windows = tuple(
        _window(prepared[run.recording].bound, signals[run.recording], run) for run in runs
    )
    units = {signal.name: signal.unit for some in signals for signal in some}
    noise = _noise(prepared, signals)
    errors = {
        name: _signal_error(unit, [w.error[name] for w in windows if name in w.error], noise[name])
        for name, unit in units.items()
    }
    positions = tuple(dict.fromkeys(s.name for some in signals for s in some if s.position))
    return Scores(windows, errors, positions, _overall(positions, windows))


def _window(bound: Bound, signals: Sequence[Signal], run: Run) -> Window:
    rows = slice(run.rows.start, run.rows.stop)
    lost = run.diverged & np.isnan(run.qpos).any(axis=1)
    measured = {signal.name: signal.measured(bound)[rows] for signal in signals}
    simulated = dict(zip(measured, predict(bound, signals, run), strict=True))
    error = {}
    for signal in signals:
        size = signal.distance(measured[signal.name], simulated[signal.name])
        missing = np.isnan(measured[signal.name]).any(axis=1)
        error[signal.name] = np.where(lost & ~missing, np.inf, size)
    return Window(
        recording=run.recording,
        start=run.rows.start,
        stop=run.rows.stop,
        time=run.time,
        qpos=run.qpos,
        qvel=run.qvel,
        measured=measured,
        simulated=simulated,
        error=error,
        rms=_norm_rms([error[s.name] for s in signals if s.position]),
        diverged=run.diverged,
    )


def _signal_error(unit: str, parts: Sequence[Floats], noise: float) -> SignalError:
    errors = np.concatenate(parts)
    errors = errors[~np.isnan(errors)]
    if not errors.size:
        return SignalError(unit, *(float("nan"),) * 3, noise)
    median, p95 = (float(x) for x in _quantiles(errors))
    return SignalError(unit, _rms(errors), median, p95, noise)


def _quantiles(errors: Floats) -> Floats:
    """Median and 95 % quantile; nothing is interpolated between infinite errors."""
    method: Any = "linear" if np.isfinite(errors).all() else "inverted_cdf"
    return np.asarray(np.quantile(errors, (0.5, 0.95), method=method))


def _rms(errors: Floats) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def _norm_rms(parts: Sequence[Floats]) -> float:
    """Root of the sum over signals of their mean squared errors."""
    known = [part[~np.isnan(part)] for part in parts]
    squares = [float(np.mean(part**2)) for part in known if part.size]
    return float(np.sqrt(sum(squares))) if squares else float("nan")


def _overall(positions: Sequence[str], windows: Sequence[Window]) -> float:
    parts = [[w.error[name] for w in windows if name in w.error] for name in positions]
    return _norm_rms([np.concatenate(part) for part in parts])


def _noise(prepared: Sequence[Prepared], signals: Sequence[Sequence[Signal]]) -> dict[str, float]:
    """Root mean square over the recordings of each signal's noise."""
    found: dict[str, list[float]] = {}
    for one, some in zip(prepared, signals, strict=True):
        for signal in some:
            found.setdefault(signal.name, []).append(signal.noise(one.bound))
    known = {n: np.array([v for v in values if np.isfinite(v)]) for n, values in found.items()}
    return {n: _rms(values) if values.size else float("nan") for n, values in known.items()}
