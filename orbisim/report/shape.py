"""The missing force at single degrees of freedom, and what it depends on."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from orbisim.effects.base import AXES
from orbisim.motion.force import ForceResidual
from orbisim.motion.samples import Samples
from orbisim.recording.joints import Joint, Kind, joints
from orbisim.report import figures
from orbisim.sensing.faults import SensorFinding

Floats = npt.NDArray[np.float64]

_BINS = 16
"""Cells along a quantity: what a smooth dependence needs, with enough samples in each."""
_FEWEST = 8
"""Samples of a cell; the mean of fewer is noise."""
_MOST_POINTS = 1500
"""Points of a chart: more than it has pixels for."""
_WORTH_SHOWING = 0.02
"""Share of the variance that a quantity must explain to be listed."""
BEFORE, AFTER, MEASURED, LEARNED = figures.B, figures.A, figures.C, "#2b8a3e"


@dataclasses.dataclass(frozen=True)
class Degree:
    """A degree of freedom of a joint.

    Attributes:
      name: for readers. joint: label of its joint. dof: its number in qvel.
      q: its number in qpos; None for rotations of ball and free joints.
      unit: of its position. force_unit: of its force.
    """

    name: str
    joint: str
    dof: int
    q: int | None
    unit: str
    force_unit: str


def degrees(model: mujoco.MjModel) -> list[Degree]:
    """All degrees of freedom of a model."""
    return [degree for joint in joints(model) for degree in _of(joint)]


def _of(joint: Joint) -> list[Degree]:
    start = joint.v.start
    if joint.scalar:
        return [
            Degree(joint.label, joint.label, start, joint.q.start, joint.unit, joint.force_unit)
        ]
    turns = [f"{joint.label}, about {axis}" for axis in "xyz"]
    if joint.kind == Kind.BALL:
        return [Degree(n, joint.label, start + i, None, "rad", "N*m") for i, n in enumerate(turns)]
    moves = [f"{joint.label}, along {axis}" for axis in "xyz"]
    return [
        *(
            Degree(n, joint.label, start + i, joint.q.start + i, "m", "N")
            for i, n in enumerate(moves)
        ),
        *(Degree(n, joint.label, start + 3 + i, None, "rad", "N*m") for i, n in enumerate(turns)),
    ]


@dataclasses.dataclass(frozen=True, eq=False)
class Course:
    """The missing force at one degree of freedom along all recordings, one after the other.

    Attributes:
      label: `as declared`, `after` ... colour: of its marks.
      force: [T], NaN where it is unknown.
    """

    label: str
    colour: str
    force: Floats


def courses(
    sets: Sequence[tuple[str, str, Sequence[ForceResidual]]], degree: Degree
) -> list[Course]:
    """The missing force of several scenes at a degree of freedom."""
    return [
        Course(label, colour, np.concatenate([part.force[:, degree.dof] for part in parts]))
        for label, colour, parts in sets
    ]


@dataclasses.dataclass(frozen=True, eq=False)
class Regressor:
    """Something that the missing force may depend on. values: [T]."""

    name: str
    unit: str
    values: Floats


def regressors(samples: Sequence[Samples], degree: Degree) -> list[Regressor]:
    """Own velocity and position first; then controls, contact, time, and the other joints."""
    model = samples[0].bound.model
    qpos, qvel, ctrl = (np.concatenate([getattr(s, n) for s in samples]) for n in _FIELDS)
    found = [Regressor(f"velocity of {degree.name}", f"{degree.unit}/s", qvel[:, degree.dof])]
    if degree.q is not None:
        found.append(Regressor(f"position of {degree.name}", degree.unit, qpos[:, degree.q]))
    names = {
        int(model.actuator_ctrladr[a]) + i: model.actuator(a).name or f"#{a}"
        for a in range(model.nactuator)
        for i in range(int(model.actuator_ctrlnum[a]))
    }
    found += [Regressor(f"control of {names[c]}", "", ctrl[:, c]) for c in sorted(names)]
    found.append(Regressor("contact", "number of contacts", _contacts(samples)))
    found.append(Regressor("time", "s", np.concatenate([s.time - s.time[0] for s in samples])))
    for other in degrees(model):
        if other.dof == degree.dof:
            continue
        found.append(Regressor(f"velocity of {other.name}", f"{other.unit}/s", qvel[:, other.dof]))
        if other.q is not None:
            found.append(Regressor(f"position of {other.name}", other.unit, qpos[:, other.q]))
    return [one for one in found if np.ptp(one.values[np.isfinite(one.values)]) > 0]


_FIELDS = ("qpos", "qvel", "ctrl")


def _contacts(samples: Sequence[Samples]) -> Floats:
    """[T]: number of contacts along the measured motion."""
    model = samples[0].bound.model
    data, found = mujoco.MjData(model), []
    for one in samples:
        count = np.zeros(len(one))
        for row in np.flatnonzero(np.isfinite(one.qpos).all(axis=1)):
            data.qpos[:] = one.qpos[row]
            mujoco.mj_fwdPosition(model, data)
            count[row] = data.ncon
        found.append(count)
    return np.concatenate(found)


def dependence(x: Floats, y: Floats) -> float:
    """Share of the variance of y that follows from x: the correlation ratio over bins of equally
    many samples, less what as many bins would explain by chance (Kelley's epsilon squared)."""
    good = np.isfinite(x) & np.isfinite(y)
    x, y = x[good], y[good]
    if len(y) < 4 * _BINS or not np.ptp(y):
        return 0.0
    number, bins = _binned(x)
    sums = np.bincount(number, y, bins)
    count = np.bincount(number, minlength=bins)
    means = sums / np.maximum(count, 1)
    within = float(((y - means[number]) ** 2).sum()) / max(len(y) - bins, 1)
    return max(0.0, 1.0 - within / float(y.var(ddof=1)))


def _binned(x: Floats) -> tuple[npt.NDArray[np.int64], int]:
    edges = np.unique(np.quantile(x, np.linspace(0, 1, _BINS + 1)[1:-1]))
    return np.searchsorted(edges, x, side="right"), len(edges) + 1


def dependence_rows(
    every: Sequence[Regressor], before: Course, after: Course
) -> list[dict[str, object]]:
    """How much of the missing force follows from each regressor alone, strongest first."""
    rows: list[dict[str, object]] = []
    for one in every:
        shares = dependence(one.values, before.force), dependence(one.values, after.force)
        if max(shares) >= _WORTH_SHOWING:
            rows.append({"name": one.name, "before": shares[0], "after": shares[1]})
    return sorted(rows, key=lambda row: -float(str(row["after"])))


# -- charts ----------------------------------------------------------------------------------------


def scatter(one: Regressor, drawn_courses: Sequence[Course], degree: Degree) -> Markup:
    """The missing force against a regressor: samples, and their mean where there are enough."""
    drawn, axes = figures.figure(height=2.8)
    for course in drawn_courses:
        good = np.flatnonzero(np.isfinite(course.force) & np.isfinite(one.values))
        pick = thin(good)
        axes.plot(
            one.values[pick], course.force[pick], linestyle="", marker=".", markersize=2.5,
            alpha=0.35, color=course.colour, label=course.label,
        )  # fmt: skip
        axes.plot(*_means(one.values[good], course.force[good]), color=course.colour, lw=2)
    within(axes, [course.force for course in drawn_courses])
    axes.set(title=f"Missing force at {degree.name}\nagainst {one.name}")
    axes.set(xlabel=f"{one.name} ({one.unit})" if one.unit else one.name, ylabel=degree.force_unit)
    figures.legend(axes, markerscale=4)
    return figures.to_svg(drawn, f"Missing force at {degree.name} against {one.name}")


def _means(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    if len(x) < _FEWEST:
        return np.zeros(0), np.zeros(0)
    number, bins = _binned(x)
    count = np.bincount(number, minlength=bins)
    full = count >= _FEWEST
    sums = [np.bincount(number, values, bins)[full] / count[full] for values in (x, y)]
    return sums[0], sums[1]


def spectrum(
    samples: Sequence[Samples],
    sets: Sequence[tuple[str, str, Sequence[ForceResidual]]],
    degree: Degree,
) -> Markup | None:
    """Power spectra of the missing force, by Welch's method in each recording, averaged."""
    from scipy import signal

    length = min(256, *(len(one) for one in samples))
    if length < 16:
        return None
    rate = 1.0 / float(np.median(np.concatenate([np.diff(one.time) for one in samples])))
    drawn, axes = figures.figure(height=2.8)
    for label, colour, parts in sets:
        powers = []
        for part in parts:
            force = np.nan_to_num(part.force[:, degree.dof])
            low, high = np.quantile(force, (0.002, 0.998))
            frequency, power = signal.welch(np.clip(force, low, high), rate, nperseg=length)
            powers.append(power)
        axes.loglog(frequency[1:], np.mean(powers, axis=0)[1:], color=colour, label=label)
    axes.set(title=f"Spectrum of the missing force at {degree.name}", xlabel="frequency (Hz)")
    axes.set_ylabel(f"({degree.force_unit})²/Hz")
    figures.legend(axes)
    return figures.to_svg(drawn, f"Spectrum of the missing force at {degree.name}")


def over_time(
    sets: Sequence[tuple[str, str, Sequence[ForceResidual]]], degree: Degree, names: Sequence[str]
) -> Markup:
    """The missing force in the recording where it is largest, with the noise."""
    size = [np.nanmean(np.square(part.force[:, degree.dof])) for part in sets[0][2]]
    worst = int(np.nanargmax(size))
    drawn, axes = figures.figure(height=2.6)
    first = sets[0][2][worst]
    rows = slice(0, _MOST_POINTS)
    time, band = first.time[rows], 2 * first.std[rows, degree.dof]
    axes.fill_between(
        time, -band, band, color=MEASURED, alpha=0.25, linewidth=0, label="twice the noise"
    )
    for label, colour, parts in sets:
        axes.plot(time, parts[worst].force[rows, degree.dof], color=colour, label=label, lw=1)
    within(axes, [parts[worst].force[rows, degree.dof] for _, _, parts in sets])
    axes.set(title=f"Missing force at {degree.name}, {names[worst]}", xlabel="time (s)")
    axes.set_ylabel(degree.force_unit)
    figures.legend(axes)
    return figures.to_svg(drawn, f"Missing force at {degree.name} over time")


def sensor(finding: SensorFinding) -> Markup:
    """Measured less expected readings of a sensor on held-out data; of several components the
    worst, of several recordings the first."""
    time = finding.time
    stop = int(np.argmax(np.diff(time) < 0)) + 1 if (np.diff(time) < 0).any() else len(time)
    pick = thin(np.arange(stop))
    worst = int(np.argmax(np.mean(finding.left_before**2, axis=0)))
    drawn, axes = figures.figure(width=12.0, height=2.6)
    name, noise = finding.sensor.label, 2 * finding.noise
    axes.axhspan(-noise, noise, color=MEASURED, alpha=0.25, linewidth=0, label="twice the noise")
    axes.plot(time[pick], finding.left_before[pick, worst], color=BEFORE, label="as declared", lw=1)
    if finding.effects:
        axes.plot(time[pick], finding.left_after[pick, worst], color=AFTER, label="after", lw=1)
    component = f", {AXES[worst]}" if finding.left_before.shape[1] > 1 else ""
    axes.set(title=f"Held out: {name}{component}, measured less expected", xlabel="time (s)")
    axes.set_ylabel(finding.sensor.unit)
    figures.legend(axes)
    return figures.to_svg(drawn, f"Readings of {name} less what it should read")


def within(axes: object, values: Sequence[Floats]) -> None:
    """Limits the y axis to what all but one in a hundred values need: single outliers would flatten
    the rest."""
    every = np.concatenate([v[np.isfinite(v)] for v in values])
    if not every.size:
        return
    low, high = np.quantile(every, (0.005, 0.995))
    spare = 0.35 * (high - low)
    if every.min() < low - spare or every.max() > high + spare:
        axes.set_ylim(low - spare, high + spare)  # type: ignore[attr-defined]


def thin(rows: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """At most so many rows, spread evenly."""
    return rows[:: max(1, len(rows) // _MOST_POINTS)]
