"""Charts of free runs on held-out data: whole episodes, and the error over a window."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from orbisim.motion.hidden import Layout
from orbisim.recording import Bound
from orbisim.replay import Replay
from orbisim.report import figures
from orbisim.report.shape import MEASURED, Degree, thin, within
from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]
Side = tuple[str, str, Replay, Scene]
"""Label, colour, the free runs, and the scene that ran."""


def episode(bound: Bound, number: int, sides: Sequence[Side], degree: Degree) -> Markup:
    """A recording with the free runs of all its windows.

    Args:
      bound: the recording, in the order of the declared scene. number: its place in the replays.
    """
    assert degree.q is not None
    drawn, axes = figures.figure(width=12.0, height=2.8)
    pick = thin(np.arange(len(bound.time)))
    measured = bound.qpos[:, degree.q]
    axes.plot(
        bound.time[pick], measured[pick], linestyle="", marker=".", markersize=3.5,
        color=MEASURED, label="measured",
    )  # fmt: skip
    for label, colour, replay, scene in sides:
        column = _column(scene, bound, degree)
        parts = [w for w in replay.windows if w.recording == number]
        time = np.concatenate([np.append(w.time, np.nan) for w in parts] or [np.zeros(0)])
        value = np.concatenate([np.append(w.qpos[:, column], np.nan) for w in parts] or [time])
        axes.plot(time, value, color=colour, label=label, lw=1.2)
    within(axes, [measured, *(_positions(s, number, bound, degree) for s in sides)])
    name = Path(bound.recording.source).name
    axes.set(title=f"{degree.name}, held out: {name}", xlabel="time (s)", ylabel=degree.unit)
    figures.legend(axes)
    return figures.to_svg(drawn, f"{degree.name} measured and simulated, held out: {name}")


def _positions(side: Side, number: int, bound: Bound, degree: Degree) -> Floats:
    _, _, replay, scene = side
    column = _column(scene, bound, degree)
    found = [w.qpos[:, column] for w in replay.windows if w.recording == number]
    return np.concatenate(found) if found else np.zeros(0)


def _column(scene: Scene, bound: Bound, degree: Degree) -> int:
    """Where a declared position stands in a scene to which effects may have added joints."""
    return int(Layout(bound.model, scene.model).q[degree.q])


def forces(
    time: Floats, courses: Sequence[tuple[str, str, Floats]], degree: Degree, name: str
) -> Markup:
    """Generalized forces at a degree of freedom over time.

    Args:
      time: [T], s. courses: label, colour and forces [T, nv] of each. name: of the recording.
    """
    drawn, axes = figures.figure(width=12.0, height=2.8)
    pick = thin(np.arange(len(time)))
    for label, colour, values in courses:
        axes.plot(time[pick], values[pick, degree.dof], color=colour, label=label, lw=1.2)
    axes.set(title=f"Force at {degree.name}, held out: {name}", xlabel="time (s)")
    axes.set_ylabel(degree.force_unit)
    figures.legend(axes)
    return figures.to_svg(drawn, f"Force at {degree.name} recorded and needed, held out: {name}")


def growth(sides: Sequence[Side], unit: str, noise: float) -> Markup:
    """The error over joint positions since the start of a window, all held-out windows together."""
    drawn, axes = figures.figure(height=2.8)
    every = []
    for label, colour, replay, _ in sides:
        since, error = _growth(replay)
        axes.plot(since, error, color=colour, label=label)
        every.append(error)
    axes.axhline(noise, color=MEASURED, linestyle="--", linewidth=1, label="noise")
    figures.log_if_wide(axes, every)
    axes.set(title="Held out: error since the start of a window", xlabel="time (s)", ylabel=unit)
    figures.legend(axes)
    return figures.to_svg(drawn, "Free-running error on held-out data over the window")


def _growth(replay: Replay) -> tuple[Floats, Floats]:
    """Time since the start of a window [B] and root mean squared norm of the error [B]."""
    since, square = [], []
    for window in replay.windows:
        parts = [np.square(window.error[name]) for name in replay.positions if name in window.error]
        if parts:
            since.append(window.time - window.time[0])
            square.append(np.sum(parts, axis=0))
    times, values = np.concatenate(since), np.concatenate(square)
    good = np.isfinite(values)
    times, values = times[good], values[good]
    edges = np.linspace(0, times.max() * (1 + 1e-9), _BINS + 1)
    number = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, _BINS - 1)
    count = np.bincount(number, minlength=_BINS)
    full = count > 0
    middle = np.bincount(number, times, _BINS)[full] / count[full]
    return middle, np.sqrt(np.bincount(number, values, _BINS)[full] / count[full])


def per_window(sides: Sequence[Side], unit: str) -> Markup:
    """The error of each held-out window, in the order of the recordings."""
    drawn, axes = figures.figure(height=2.8)
    every = []
    for label, colour, replay, _ in sides:
        values = np.array([w.rms for w in replay.windows])
        axes.plot(values, linestyle="", marker="o", markersize=3, color=colour, label=label)
        every.append(values)
    figures.log_if_wide(axes, every)
    axes.set(title="Held out: error of every window", xlabel="window", ylabel=unit)
    figures.legend(axes)
    return figures.to_svg(drawn, "Free-running error of every held-out window")


_BINS = 25
"""Points of a curve over the window: smooth to the eye, and each still the mean of many samples."""
