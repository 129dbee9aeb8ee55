"""The page of `orbisim replay`."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from orbisim.files.writing import write_text
from orbisim.replay import Replay, Window
from orbisim.report import figures
from orbisim.report.page import render_page, si

Floats = npt.NDArray[np.float64]

_BINS = 120
"""Points of a curve over the window at most; each holds ten samples or more."""
_MAX_CHARTS = 12
"""Signals with a chart of their own, the worst first: a page that one reads to the end."""
_MAX_OVERLAYS = 6
"""Signals shown beside the recording for each of the chosen windows."""
_MAX_POINTS = 1500
"""Points of a curve: more than a chart has pixels for."""
_MAX_PARTS = 4
"""Components of a vector in one chart: a quaternion has four."""


def write_report(result: Replay, path: Path) -> Path:
    """Writes the page; returns its path."""
    shown = _most_telling(result, _MAX_CHARTS)
    page = render_page(
        "replay.html",
        result=result,
        summary=_summary(result),
        rows=_rows(result),
        growth_charts=[_growth_chart(result, name) for name in shown],
        left_out=len(result.signals) - len(shown),
        picks=_picks(result),
        window_chart=_window_chart(result) if len(result.windows) > 1 else None,
        command=_command(result),
    )
    write_text(path, page)
    return path


def _command(result: Replay) -> str:
    mapped = [] if result.map_file is None else ["--map", result.map_file]
    files = shlex.join([result.scene, *result.recordings, *mapped])
    return f"orbisim replay {files} --backend {result.backend} --window {result.window_s:g}"


def _summary(result: Replay) -> str:
    """One sentence: how far off, and against what noise."""
    count = len(result.windows)
    span = f"of {si(result.window_s, 's')}" if result.window_s else "from the first sample on"
    text = f"Over {count} window{'s' * (count != 1)} {span}, "
    if result.rms != result.rms:
        return f"{text}no joint position was both measured and simulated."
    if math.isinf(result.rms):
        return f"{text}the simulation became non-finite in {result.diverged}."
    text += f"joint positions are off by {result.rms:.3g} {result.unit} (rms)"
    noise = _overall_noise(result)
    if noise > 0:
        text += f"; the noise of the measurement is {noise:.2g}, {_times(result.rms / noise)}"
    return f"{text}."


def _times(ratio: float) -> str:
    if ratio < 1.5:
        return "as large as that"
    return f"{ratio:,.0f} times smaller" if ratio >= 10 else f"{ratio:.2g} times smaller"


def _overall_noise(result: Replay) -> float:
    """The norm of the noise over joint positions; NaN if it is not known of all."""
    noise = np.array([result.noise_floor(name) for name in result.positions])
    return float(np.sqrt((noise**2).sum()))


def _rows(result: Replay) -> list[dict[str, Any]]:
    return [
        {
            "name": name,
            "unit": error.unit,
            "rms": error.rms,
            "median": error.median,
            "p95": error.p95,
            "noise": error.noise,
            "ratio": _over_noise(result, name),
        }
        for name, error in result.signals.items()
    ]


def _over_noise(result: Replay, name: str) -> float:
    floor = result.noise_floor(name)
    return result.signals[name].rms / floor if floor > 0 else math.nan


def _most_telling(result: Replay, count: int) -> list[str]:
    """Joint positions first, then what is furthest beyond its noise; in the order of the table."""

    def rank(name: str) -> tuple[bool, float]:
        ratio = _over_noise(result, name)
        return name not in result.positions, -np.nan_to_num(ratio, nan=-1.0, posinf=1e300)

    chosen = set(sorted(result.signals, key=rank)[:count])
    return [name for name in result.signals if name in chosen]


# ---- error over the time since the start -------------------------------------------------------


def _growth_chart(result: Replay, name: str) -> Markup:
    drawn, axes = figures.figure(height=2.6)
    error = result.signals[name]
    since, size = _pooled(result.windows, name)
    if np.isfinite(size).any():
        time, quantiles = _by_time(since, size)
        low, middle, high = quantiles
        axes.fill_between(time, low, high, color=figures.B, alpha=0.18, linewidth=0)
        axes.plot(time, middle, color=figures.B, label="median, 5 to 95 %")
        floor = result.noise_floor(name)
        if floor > 0:
            axes.axhline(floor, color=figures.C, linestyle=":", label="measurement noise")
        figures.log_if_wide(axes, [middle, high])
        figures.legend(axes)
    axes.set(title=f"Error of {name}", xlabel="time since the start of the window (s)")
    axes.set_ylabel(error.unit)
    return figures.to_svg(drawn, f"Error of {name} over the time since the window's start")


def _pooled(windows: Sequence[Window], name: str) -> tuple[Floats, Floats]:
    """Time since the start and error, of all samples of all windows."""
    having = [window for window in windows if name in window.error]
    since = [window.time - window.time[0] for window in having]
    return np.concatenate(since), np.concatenate([window.error[name] for window in having])


def _by_time(since: Floats, size: Floats) -> tuple[Floats, Floats]:
    """Quantiles [3, K] of the error in bins of time, and the middles [K] of the bins.

    There are as many bins as give each of them some ten samples, at most 120.
    """
    known = np.isfinite(size)
    since, size = since[known], size[known]
    order = np.argsort(since, kind="stable")
    count = max(1, min(_BINS, len(order) // 10))
    edges = np.linspace(0.0, float(since.max()) * (1 + 1e-12), count + 1)
    parts = np.split(order, np.searchsorted(since[order], edges[1:-1]))
    filled = [part for part in parts if part.size]
    time = np.array([since[part].mean() for part in filled])
    found = np.array([np.quantile(size[part], (0.05, 0.5, 0.95)) for part in filled])
    return time, found.T


# ---- windows -----------------------------------------------------------------------------------


def _picks(result: Replay) -> list[dict[str, Any]]:
    """The worst window and the median one, with what was measured and simulated."""
    order = np.argsort([np.nan_to_num(w.rms, nan=-1.0) for w in result.windows], kind="stable")
    chosen = {"The worst window": int(order[-1])}
    if len(order) > 2:
        chosen["The median window"] = int(order[len(order) // 2])
    picks: list[dict[str, Any]] = []
    for title, index in chosen.items():
        window = result.windows[index]
        names = _most_telling(result, _MAX_OVERLAYS)
        picks.append(
            {
                "title": title if len(order) > 1 else "The recording",
                "where": _where(result, window),
                "rms": window.rms,
                "charts": [
                    _overlay(window, name, result.signals[name].unit)
                    for name in names
                    if name in window.error
                ],
            }
        )
    return picks


def _where(result: Replay, window: Window) -> str:
    name = result.recordings[window.recording]
    return f"{name}, {window.time[0]:.6g} to {window.time[-1]:.6g} s"


def _overlay(window: Window, name: str, unit: str) -> Markup:
    """Measured samples as dots, the simulation as lines; components in the order of the file."""
    measured, simulated = window.measured[name], window.simulated[name]
    if unit == "rad" and measured.shape[1] == 4:  # q and -q are the same orientation
        simulated = simulated * np.where((measured * simulated).sum(1) < 0, -1.0, 1.0)[:, None]
        unit = "quaternion"
    every = np.unique(np.linspace(0, len(window.time) - 1, _MAX_POINTS).round().astype(int))
    drawn, axes = figures.figure(height=2.4)
    for part in range(min(measured.shape[1], _MAX_PARTS)):
        label = {0: ("measured", "simulated")}.get(part, (None, None))
        axes.plot(
            window.time[every], measured[every, part], color=figures.A, label=label[0],
            linestyle="none", marker=".", markersize=3,
        )  # fmt: skip
        axes.plot(window.time[every], simulated[every, part], color=figures.B, label=label[1])
    axes.set(title=name, xlabel="time (s)", ylabel=unit)
    figures.legend(axes)
    return figures.to_svg(drawn, f"{name}, measured and simulated over time")


def _window_chart(result: Replay) -> Markup:
    """The error of each window, in the order of the recordings."""
    rms = np.array([window.rms for window in result.windows])
    number = np.array([window.recording for window in result.windows])
    drawn, axes = figures.figure(width=10, height=2.6)
    for recording in dict.fromkeys(number.tolist()):
        where = np.flatnonzero(number == recording)
        colour = figures.B if recording % 2 == 0 else figures.A
        axes.plot(where, np.where(np.isfinite(rms[where]), rms[where], np.nan), ".", color=colour)
    figures.log_if_wide(axes, [rms])
    axes.set(title="Joint positions, rms of each window", xlabel="window", ylabel=result.unit)
    return figures.to_svg(drawn, "rms error of joint positions in each window")
