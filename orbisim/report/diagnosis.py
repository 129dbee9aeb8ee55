"""The page of `orbisim diagnose`."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from orbisim.diagnosis.force import ForceResidual, force_residual
from orbisim.diagnosis.result import Diagnosis
from orbisim.diagnosis.samples import prepare_all
from orbisim.diagnosis.scoring import score
from orbisim.diagnosis.wording import number
from orbisim.effects import find
from orbisim.recording.joints import Joint, joints
from orbisim.replay import Replay
from orbisim.report import figures
from orbisim.report.page import render_page

Floats = npt.NDArray[np.float64]

_MOST_JOINTS = 3
_MOST_POINTS = 1500
_BEFORE, _AFTER, _MEASURED = figures.B, figures.A, figures.C


def write_report(diagnosis: Diagnosis, path: Path) -> Path:
    """Writes the page; returns its path."""
    found = diagnosis.attribution
    samples = found.samples
    before = force_residual(samples, diagnosis.scene)
    after = _after(diagnosis)
    shown = _worst_joints(diagnosis)
    page = render_page(
        "diagnosis.html",
        d=diagnosis,
        sentence=diagnosis.sentence,
        error=diagnosis.error,
        phrases={e.effect: find(e.effect).phrase for e in diagnosis.effects},
        rivals=sorted(found.rivals, key=lambda r: (r.round, r.delta_bic)),
        force_rows=_force_rows(diagnosis, before, after),
        time_charts=[_time_chart(diagnosis, j, before, after) for j in shown],
        dependence_charts=[c for j in shown for c in _dependence(diagnosis, j, before, after)],
        overlay_charts=_overlays(diagnosis),
        left_charts=[c for j in shown[:1] for c in _left(diagnosis, j, after or before)],
        command=_command(diagnosis),
        number=number,
    )
    path.write_text(page, encoding="utf-8")
    return path


def _command(diagnosis: Diagnosis) -> str:
    files = [diagnosis.source, *(one.source for one in diagnosis.fit)]
    how = f"--window {diagnosis.error['window_s']:g}"
    if _in_forces(diagnosis):
        how = "--residual force"
    return f"orbisim diagnose {shlex.join(files)} {how}"


def _in_forces(diagnosis: Diagnosis) -> bool:
    """Whether the residual in force space was explained, instead of free runs."""
    return diagnosis.error.get("residual") == "force"


def _after(diagnosis: Diagnosis) -> list[ForceResidual] | None:
    """The force-space residual with the effects, where all of them are native and none is of the
    measurement; what is left over sampling intervals says the rest."""
    changed = diagnosis.effects or diagnosis.retuned
    if not changed or not all(e.native for e in diagnosis.effects):
        return None
    return force_residual(diagnosis.attribution.samples, diagnosis.augmented_scene)


def _worst_joints(diagnosis: Diagnosis) -> list[Joint]:
    """Joints with effects, then those with the largest share of the residual."""
    every = {j.label: j for j in joints(diagnosis.scene.model) if j.scalar}
    named = [e.target for e in diagnosis.effects]
    named += [str(w["target"]) for w in diagnosis.residual["where"]]
    chosen = [every[name] for name in dict.fromkeys(named) if name in every]
    return (chosen or list(every.values()))[:_MOST_JOINTS]


def _force_rows(
    diagnosis: Diagnosis, before: list[ForceResidual], after: list[ForceResidual] | None
) -> list[dict[str, Any]]:
    """Root mean square of the generalized-force residual of each degree of freedom."""

    def rms(parts: list[ForceResidual], field: str, column: int) -> float:
        values = np.concatenate([getattr(p, field)[:, column] for p in parts])
        values = values[np.isfinite(values)]
        return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")

    rows = []
    for joint in joints(diagnosis.scene.model):
        for i, column in enumerate(range(joint.v.start, joint.v.stop)):
            part = "" if joint.scalar else f"[{i}]"
            rows.append(
                {
                    "name": f"{joint.label}{part}",
                    "unit": joint.force_unit,
                    "needed": rms(before, "total", column),
                    "noise": rms(before, "std", column),
                    "before": rms(before, "force", column),
                    "after": rms(after, "force", column) if after else None,
                }
            )
    return rows


# -- charts ----------------------------------------------------------------------------------------


def _time_chart(
    diagnosis: Diagnosis,
    joint: Joint,
    before: list[ForceResidual],
    after: list[ForceResidual] | None,
) -> Markup:
    column, one = joint.v.start, before[0]
    drawn, axes = figures.figure(height=2.6)
    rows = slice(0, min(len(one.time), _MOST_POINTS))
    axes.fill_between(
        one.time[rows], -2 * one.std[rows, column], 2 * one.std[rows, column],
        color=_MEASURED, alpha=0.25, linewidth=0, label="twice the noise",
    )  # fmt: skip
    axes.plot(one.time[rows], one.force[rows, column], color=_BEFORE, label="as declared", lw=1)
    if after:
        axes.plot(one.time[rows], after[0].force[rows, column], color=_AFTER, label="after", lw=1)
    axes.set(title=f"Missing force at {joint.label}", xlabel="time (s)", ylabel=joint.force_unit)
    figures.legend(axes, ncols=3)
    return figures.to_svg(drawn, f"Missing force at {joint.label} over time")


def _dependence(
    diagnosis: Diagnosis,
    joint: Joint,
    before: list[ForceResidual],
    after: list[ForceResidual] | None,
) -> list[Markup]:
    """The missing force against velocity and position."""
    samples = diagnosis.attribution.samples
    column = joint.v.start
    against = {
        f"velocity ({joint.unit}/s)": np.concatenate([s.qvel[:, column] for s in samples]),
        f"position ({joint.unit})": np.concatenate([s.qpos[:, joint.q.start] for s in samples]),
    }
    force = np.concatenate([p.force[:, column] for p in before])
    left = np.concatenate([p.force[:, column] for p in after]) if after else None
    charts = []
    for label, x in against.items():
        drawn, axes = figures.figure(height=2.8)
        pick = _thin(np.flatnonzero(np.isfinite(force) & np.isfinite(x)))
        dots = {"linestyle": "", "marker": ".", "markersize": 2.5, "alpha": 0.5}
        axes.plot(x[pick], force[pick], color=_BEFORE, label="as declared", **dots)
        if left is not None:
            axes.plot(x[pick], left[pick], color=_AFTER, label="after", **dots)
        axes.set(title=f"{joint.label}: missing force against {label.split(' ')[0]}")
        axes.set(xlabel=label, ylabel=joint.force_unit)
        figures.legend(axes, markerscale=4)
        charts.append(figures.to_svg(drawn, f"Missing force at {joint.label} against {label}"))
    return charts


def _left(diagnosis: Diagnosis, joint: Joint, parts: list[ForceResidual]) -> list[Markup]:
    """Shape of what is left: its spectrum, and its course with the control."""
    from scipy import signal

    column, one = joint.v.start, parts[0]
    force = np.nan_to_num(one.force[:, column])
    charts = []
    if len(force) >= 16:
        rate = 1.0 / float(np.median(np.diff(one.time)))
        frequency, power = signal.welch(force, rate, nperseg=min(256, len(force)))
        drawn, axes = figures.figure(height=2.6)
        axes.loglog(frequency[1:], power[1:], color=_AFTER)
        axes.set(title=f"Spectrum of what is left at {joint.label}", xlabel="frequency (Hz)")
        axes.set_ylabel(f"({joint.force_unit})²/Hz")
        charts.append(figures.to_svg(drawn, "Spectrum of what is left"))
    samples = diagnosis.attribution.samples[0]
    for control in range(min(samples.ctrl.shape[1], 2)):
        drawn, axes = figures.figure(height=2.6)
        pick = _thin(np.arange(len(force)))
        axes.plot(
            samples.ctrl[pick, control], force[pick], linestyle="", marker=".", markersize=2.5,
            alpha=0.5, color=_AFTER,
        )  # fmt: skip
        axes.set(title=f"What is left at {joint.label} against control {control}")
        axes.set(xlabel="control", ylabel=joint.force_unit)
        charts.append(figures.to_svg(drawn, f"What is left against control {control}"))
    return charts


def _overlays(diagnosis: Diagnosis) -> list[Markup]:
    """The held-out window that was worst, and the median one: measured, before and after."""
    if _in_forces(diagnosis):
        return _needed(diagnosis)
    window = diagnosis.error["window_s"]
    effects = diagnosis.attribution.hypothesis.effects
    held = list(diagnosis.held_out)
    before = score(diagnosis.scene, held, window).replay
    changed = bool(effects) or bool(diagnosis.retuned)
    after = score(diagnosis.augmented_scene, held, window, effects).replay if changed else None
    order = np.argsort([w.rms if np.isfinite(w.rms) else np.inf for w in before.windows])
    picks = dict.fromkeys([int(order[-1]), int(order[len(order) // 2])])
    charts = []
    shown = _worst_joints(diagnosis) or list(joints(diagnosis.scene.model))[:1]
    for pick in picks:
        for joint in shown[:2]:
            charts.append(_overlay(diagnosis, joint, before, after, pick))
    return charts


def _needed(diagnosis: Diagnosis) -> list[Markup]:
    """Forces that the held-out motion needs with and without the effects, and those recorded."""
    held = prepare_all(diagnosis.held_out[:1], diagnosis.scene)
    before = force_residual(held, diagnosis.scene)[0]
    after = force_residual(held, diagnosis.augmented_scene)[0]
    name, charts = Path(diagnosis.held_out[0].source).name, []
    rows = slice(0, min(len(before.time), _MOST_POINTS))
    for joint in _worst_joints(diagnosis):
        column, time = joint.v.start, before.time[rows]
        given = (before.total - before.force)[rows, column]
        drawn, axes = figures.figure(height=2.6)
        axes.plot(time, given, color=_MEASURED, label="recorded", lw=2)
        axes.plot(time, given + before.force[rows, column], color=_BEFORE, label="as declared")
        axes.plot(time, given + after.force[rows, column], color=_AFTER, label="after")
        axes.set(title=f"Force at {joint.label}, held out: {name}", xlabel="time (s)")
        axes.set_ylabel(joint.force_unit)
        figures.legend(axes, ncols=3)
        charts.append(figures.to_svg(drawn, f"Recorded and needed force at {joint.label}"))
    return charts


def _overlay(
    diagnosis: Diagnosis, joint: Joint, before: Replay, after: Replay | None, pick: int
) -> Markup:
    window = before.windows[pick]
    bound = diagnosis.held_out[window.recording].bind(diagnosis.scene)
    rows, column = slice(window.start, window.stop), joint.q.start
    drawn, axes = figures.figure(height=2.6)
    axes.plot(
        window.time, bound.qpos[rows, column], linestyle="", marker=".", markersize=4,
        color=_MEASURED, label="measured",
    )  # fmt: skip
    axes.plot(window.time, window.qpos[:, column], color=_BEFORE, label="as declared")
    if after is not None and pick < len(after.windows):
        other = after.windows[pick]
        axes.plot(other.time, other.qpos[:, _column(diagnosis, joint)], color=_AFTER, label="after")
    name = Path(bound.recording.source).name
    axes.set(title=f"{joint.label}, held out: {name}", xlabel="time (s)", ylabel=joint.unit)
    figures.legend(axes, ncols=3)
    return figures.to_svg(drawn, f"{joint.label} measured and simulated in a held-out window")


def _column(diagnosis: Diagnosis, joint: Joint) -> int:
    """Where a declared joint's position stands in the augmented scene."""
    return int(
        diagnosis.augmented_scene.model.joint(joint.id if not joint.name else joint.name).qposadr[0]
    )


def _thin(rows: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    return rows[:: max(1, len(rows) // _MOST_POINTS)]
