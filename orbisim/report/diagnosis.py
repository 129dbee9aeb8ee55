"""The page of `orbisim diagnose`."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from orbisim.diagnosis.result import Diagnosis
from orbisim.diagnosis.scoring import score
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.wording import interval, number
from orbisim.effects import find
from orbisim.effects.confounds import advice
from orbisim.effects.measured import correct
from orbisim.files.writing import write_text
from orbisim.motion.force import ForceResidual, force_residual
from orbisim.motion.samples import Samples, prepare_all
from orbisim.recording import Recording, bind
from orbisim.recording.recording import common_map
from orbisim.report import held_out, shape
from orbisim.report.notes import merged
from orbisim.report.page import render_page
from orbisim.report.shape import AFTER, BEFORE, LEARNED, MEASURED, Degree

Floats = npt.NDArray[np.float64]
Sets = list[tuple[str, str, list[ForceResidual]]]

# a page shows the worst of each kind: more charts are not looked at
_MOST_DEGREES = 3
# the same motion again says little more
_MOST_EPISODES = 2
# as many as stand on two lines of small charts
_MOST_REGRESSORS = 8
# what to do next is read from the top
_MOST_ADVICE = 6
# share of a force's variance that one regressor explains and advice names
_STRONG = 0.1
# as for degrees
_MOST_SENSORS = 4
# times its noise that a sensor's residual must be to be shown, as in a verdict
_OFF = 1.5


def write_report(diagnosis: Diagnosis, path: Path) -> Path:
    """Writes the page; returns its path."""
    samples = diagnosis.attribution.samples
    sets = _sets(diagnosis)
    shown = _worst(diagnosis, sets)
    left = diagnosis.verdict in ("unexplained", "partly_explained")
    worst = _by_what_is_left(diagnosis, sets)[0]
    rows, left_charts = _left(samples, sets, worst) if left else ([], [])
    page = render_page(
        "diagnosis.html",
        d=diagnosis,
        sentence=diagnosis.sentence,
        error=diagnosis.error,
        phrases={e.effect: find(e.effect).phrase for e in diagnosis.effects},
        chosen={(e.effect, e.target) for e in diagnosis.effects},
        changed=_changed(diagnosis),
        force_rows=_force_rows(diagnosis, sets),
        time_charts=[shape.over_time(sets, d, [_name(s) for s in samples]) for d in shown],
        dependence_charts=[c for d in shown for c in _dependence(samples, sets, d)],
        held_charts=_held(diagnosis, shown),
        sensors=[] if diagnosis.sensors is None else diagnosis.sensors.findings,
        sensor_charts=_sensor_charts(diagnosis),
        left_rows=rows,
        left_charts=left_charts,
        left_at=worst.name,
        advice=_advice(diagnosis, rows, worst),
        command=_command(diagnosis),
        notes=merged(diagnosis.notes),
        origin=diagnosis.origin,
        number=number,
        interval=interval,
    )
    write_text(path, page)
    return path


def _command(diagnosis: Diagnosis) -> str:
    fit, held = (_files(part) for part in (diagnosis.fit, diagnosis.held_out))
    apart = [word for name in held if name not in fit for word in ("--held-out", name)]
    window = ["--window", f"{diagnosis.error['window_s']:g}"]
    if _in_forces(diagnosis):
        window = ["--residual", "force"]
    rest = [] if diagnosis.rest is None else ["--learn-rest"]
    read_by = common_map((*diagnosis.fit, *diagnosis.held_out))
    mapped = [] if read_by is None else ["--map", read_by]
    words = ["orbisim", "diagnose", diagnosis.source, *fit, *apart, *mapped, *window, *rest]
    return shlex.join([*words, *_told(diagnosis)])


def _told(diagnosis: Diagnosis) -> list[str]:
    """Options that were not the command's defaults."""
    told, usual = diagnosis.settings, Settings()
    words = [word for name in told.effects or () for word in ("--effect", name)]
    for option in ("most_effects", "patience", "seed"):
        value = getattr(told, option)
        if value != getattr(usual, option):
            words += [f"--{option.replace('_', '-')}", f"{value:g}"]
    words += [] if told.retune else ["--no-retune"]
    return words + ([] if diagnosis.backend == "mujoco" else ["--backend", diagnosis.backend])


def _in_forces(diagnosis: Diagnosis) -> bool:
    """Whether the residual in force space was explained, instead of free runs."""
    return diagnosis.error.get("residual") == "force"


def _files(recordings: Sequence[Recording]) -> list[str]:
    """Where recordings came from; stretches of one come from the same file."""
    return list(dict.fromkeys(_STRETCH.sub("", one.source) for one in recordings))


_STRETCH = re.compile(r"\[\S+ s to \S+ s\]$")


def _name(one: Samples) -> str:
    return Path(one.source).name


def _changed(diagnosis: Diagnosis) -> bool:
    """Whether the scene, or what it is compared with, is another one after the diagnosis."""
    hypothesis = diagnosis.attribution.hypothesis
    return bool(hypothesis.effects or hypothesis.factors)


# -- the missing force -----------------------------------------------------------------------------


def _sets(diagnosis: Diagnosis) -> Sets:
    """The missing force with the scene as declared, after, and with a learned force."""
    samples = list(diagnosis.attribution.samples)
    sets: Sets = [("as declared", BEFORE, force_residual(samples, diagnosis.scene))]
    effects = diagnosis.attribution.hypothesis.effects
    if any(find(e.effect).measurement for e in effects):
        true = [correct(s.bound.recording, effects, diagnosis.scene) for s in samples]
        samples = prepare_all(true, diagnosis.scene)
    if _changed(diagnosis) and all(len(a) == len(b) for a, b in _pairs(diagnosis, samples)):
        sets.append(("after", AFTER, force_residual(samples, diagnosis.augmented_scene)))
    if diagnosis.rest is not None and diagnosis.rest.scene is not None:
        learned = force_residual(samples, diagnosis.rest.scene)
        sets.append(("with the learned force", LEARNED, learned))
    return sets


def _pairs(diagnosis: Diagnosis, samples: Sequence[Samples]) -> list[tuple[Samples, Samples]]:
    """As recorded, and corrected: a late sensor's recording is shorter once it is corrected."""
    return list(zip(diagnosis.attribution.samples, samples, strict=True))


def _worst(diagnosis: Diagnosis, sets: Sets) -> list[Degree]:
    """Degrees of freedom with effects, then those where the residual is."""
    every = _by_what_is_left(diagnosis, sets)
    named = [e.target for e in diagnosis.effects]
    named += [str(w["target"]) for w in diagnosis.residual["where"]]
    first = [d for name in dict.fromkeys(named) for d in every if d.joint == name]
    return (first or every)[:_MOST_DEGREES]


def _by_what_is_left(diagnosis: Diagnosis, sets: Sets) -> list[Degree]:
    """All degrees of freedom, most left first, by the noise there, without a learned force."""
    left = next((parts for label, _, parts in sets if label == "after"), sets[0][2])
    every = shape.degrees(diagnosis.scene.model)
    ratio = {d.dof: _usual(left, "force", d.dof) / _usual(sets[0][2], "std", d.dof) for d in every}
    return sorted(every, key=lambda d: -np.nan_to_num(ratio[d.dof]))


def _usual(parts: Sequence[ForceResidual], field: str, dof: int) -> float:
    """What two of three samples stay below, so that single outliers do not count."""
    values = np.concatenate([getattr(part, field)[:, dof] for part in parts])
    values = np.abs(values[np.isfinite(values)])
    return max(float(np.quantile(values, 0.68)), 1e-12) if values.size else float("nan")


def _rms(parts: Sequence[ForceResidual], field: str, dof: int) -> float:
    values = np.concatenate([getattr(part, field)[:, dof] for part in parts])
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def _force_rows(diagnosis: Diagnosis, sets: Sets) -> list[dict[str, Any]]:
    """Root mean square of the generalized-force residual of each degree of freedom."""
    found = {label: parts for label, _, parts in sets}
    before, after = found["as declared"], found.get("after")
    return [
        {
            "name": one.name,
            "unit": one.force_unit,
            "needed": _rms(before, "total", one.dof),
            "noise": _rms(before, "std", one.dof),
            "before": _rms(before, "force", one.dof),
            "after": _rms(after, "force", one.dof) if after else None,
        }
        for one in shape.degrees(diagnosis.scene.model)
    ]


def _aligned(samples: Sequence[Samples], sets: Sets) -> Sets:
    """Those sets that have the samples of the recordings."""
    lengths = [len(s) for s in samples]
    return [one for one in sets if [len(part.time) for part in one[2]] == lengths]


def _dependence(samples: Sequence[Samples], sets: Sets, degree: Degree) -> list[Markup]:
    """The missing force against velocity and position."""
    courses = shape.courses(_aligned(samples, sets), degree)
    own = [r for r in shape.regressors(samples, degree) if r.name in _own(degree)]
    return [shape.scatter(one, courses, degree) for one in own]


def _own(degree: Degree) -> tuple[str, str]:
    return f"velocity of {degree.name}", f"position of {degree.name}"


def _left(
    samples: Sequence[Samples], sets: Sets, degree: Degree
) -> tuple[list[dict[str, Any]], list[Markup]]:
    """The shape of what is left: its spectrum, and what it depends on."""
    sets = _aligned(samples, sets)
    courses = shape.courses(sets, degree)
    after = next((c for c in courses if c.label == "after"), courses[0])
    every = shape.regressors(samples, degree)
    rows: list[dict[str, Any]] = list(shape.dependence_rows(every, courses[0], after))
    drawn = shape.spectrum(samples, sets, degree)
    charts = [] if drawn is None else [drawn]
    strong = [str(row["name"]) for row in rows]
    others = [r for r in every if r.name not in _own(degree)]
    always = [r for r in others if r.name in ("contact", "time") or r.name.startswith("control")]
    more = sorted(
        (r for r in others if r in always or r.name in strong),
        key=lambda r: strong.index(r.name) if r.name in strong else len(strong),
    )
    return rows, charts + [shape.scatter(one, courses, degree) for one in more[:_MOST_REGRESSORS]]


# -- held-out data ---------------------------------------------------------------------------------


def _held(diagnosis: Diagnosis, shown: Sequence[Degree]) -> dict[str, list[Markup]]:
    """Free runs on held-out data: whole episodes, and the error over windows. Or forces, if those
    were explained."""
    if _in_forces(diagnosis):
        return {"episodes": _needed(diagnosis, shown), "errors": []}
    sides = _sides(diagnosis)
    episodes = []
    for i, recording in enumerate(list(diagnosis.held_out)[:_MOST_EPISODES]):
        bound = bind(recording, diagnosis.scene)
        for degree in [d for d in shown if d.q is not None][:2]:
            episodes.append(held_out.episode(bound, i, sides, degree))
    unit = diagnosis.error["unit"]
    growth = held_out.growth(sides, unit, diagnosis.error["noise_floor"])
    return {"episodes": episodes, "errors": [growth, held_out.per_window(sides, unit)]}


def _needed(diagnosis: Diagnosis, shown: Sequence[Degree]) -> list[Markup]:
    """Forces that the held-out motion needs with and without the effects, and those recorded."""
    held = prepare_all(diagnosis.held_out[:1], diagnosis.scene)
    before = force_residual(held, diagnosis.scene)[0]
    after = force_residual(held, diagnosis.augmented_scene)[0]
    given = before.total - before.force
    courses = [
        ("recorded", MEASURED, given),
        ("as declared", BEFORE, given + before.force),
        ("after", AFTER, given + after.force),
    ]
    name = Path(diagnosis.held_out[0].source).name
    return [held_out.forces(before.time, courses, degree, name) for degree in shown]


def _sides(diagnosis: Diagnosis) -> list[held_out.Side]:
    window = diagnosis.error["window_s"]
    effects = diagnosis.attribution.hypothesis.effects
    held = list(diagnosis.held_out)
    scene, augmented = diagnosis.scene, diagnosis.augmented_scene
    found = [("as declared", BEFORE, score(scene, held, window), scene)]
    if _changed(diagnosis):
        after = score(augmented, held, window, effects)
        found.append(("after", AFTER, after, augmented))
    if diagnosis.rest is not None and diagnosis.rest.scene is not None:
        learned = diagnosis.rest.scene
        found.append(
            (
                "with the learned force",
                LEARNED,
                score(learned, held, window, effects),
                learned,
            )
        )
    return found


def _sensor_charts(diagnosis: Diagnosis) -> list[Markup]:
    """Readings of the sensors that are off, worst first."""
    findings = [] if diagnosis.sensors is None else list(diagnosis.sensors.findings)
    findings.sort(key=lambda one: (not one.effects, -one.before))
    off = [one for one in findings if one.effects or one.before > _OFF]
    return [shape.sensor(one) for one in off[:_MOST_SENSORS]]


# -- what to record next ---------------------------------------------------------------------------


def _advice(diagnosis: Diagnosis, rows: Sequence[dict[str, Any]], worst: Degree) -> list[str]:
    """What to record next, most useful first."""
    found = []
    for effect in diagnosis.effects:
        for other in diagnosis.alternatives:
            tip = advice(effect.effect, other.effect)
            if tip is not None:
                where = f" at {other.target}" if other.target else ""
                found.append(
                    f"To tell {effect.effect} at {effect.target} from {other.effect}{where}: {tip}."
                )
    if diagnosis.verdict in ("unexplained", "partly_explained"):
        strong = [row for row in rows if row["after"] >= _STRONG]
        for row in strong[:2]:
            found.append(
                f"What is left at {worst.name} goes with {row['name']} "
                f"({100 * row['after']:.0f} % of its variance): record runs in which that varies "
                "while everything else hardly does."
            )
        if not strong:
            found.append(
                f"What is left at {worst.name} goes with nothing that is recorded: record what "
                "else acts there (a torque or current, a second sensor beyond the transmission)."
            )
    return list(dict.fromkeys(found))[:_MOST_ADVICE]
