"""The page of `orbisim compare`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from orbisim import metrics
from orbisim.compare import Comparison, Side
from orbisim.errors import OrbiSimError, RenderingUnavailableError
from orbisim.files.writing import write_text
from orbisim.registry import make_renderer
from orbisim.report import figures, video
from orbisim.report.page import render_page, si
from orbisim.scene.descriptor import name_of

Floats = npt.NDArray[np.float64]

_SIZE = {"height": 240, "width": 320}
"""Of a video, pixels: two of them side by side fit a page."""
_MUJOCO = "mujoco"
_FPS = 30
"""Frames of the videos for each second of simulated time."""
_TITLES = {
    "joint_position": "Joint position",
    "joint_velocity": "Joint velocity",
    "object_position": "Object position",
    "object_rotation": "Object rotation",
    "object_velocity": "Object velocity",
}
_MAX_JOINTS = 6
"""Charts of the worst episode: the joints that differ most say what there is to see."""


def write_report(
    comparison: Comparison, path: Path, *, video: bool = True, renderer: str = _MUJOCO
) -> Path:
    """Writes the page; returns its path."""
    film, reason = _film(comparison, renderer) if video else (None, "it was not asked for")
    page = render_page(
        "compare.html",
        source=comparison.source,
        a=comparison.a,
        b=comparison.b,
        episodes=comparison.episodes,
        worst=comparison.worst_episode,
        rows=_rows(comparison),
        summary=_summary(comparison),
        first=float(comparison.horizon_s[0]),
        last=float(comparison.horizon_s[-1]),
        horizon=float(comparison.horizon_s[-1]),
        has_rounding=comparison.rounding is not None,
        error_charts=[_error_chart(comparison, group) for group in comparison.error],
        worst_charts=_worst_charts(comparison),
        state_charts=_state_charts(comparison),
        touching=_touching(comparison),
        penetration_charts=_penetration_charts(comparison),
        interval_charts=_interval_charts(comparison),
        speed_note=_speed_note(comparison),
        seed=comparison.seed,
        diverged=comparison.diverged,
        faults=comparison.faults,
        video=film,
        renderer="" if renderer == _MUJOCO else renderer,
        no_video=reason,
        command=_command(comparison),
    )
    write_text(path, page)
    return path


def _command(comparison: Comparison) -> str:
    return (
        f"orbisim compare {comparison.source} --a {comparison.a.backend} "
        f"--b {comparison.b.backend} --episodes {comparison.episodes} "
        f"--horizon {comparison.horizon_s[-1]:g} --seed {comparison.seed}"
    )


def _rows(comparison: Comparison) -> list[dict[str, Any]]:
    units = metrics.layout(comparison.scene.model).units
    rows: list[dict[str, Any]] = []
    for group, values in comparison.error.items():
        median, p95 = metrics.quantiles(values)
        rounding = ratio = None
        if comparison.rounding is not None:
            rounded = metrics.quantiles(comparison.rounding[group], (0.5,))[0]
            rounding, ratio = rounded[-1], _beside_rounding(median, rounded)
        rows.append(
            {
                "name": _TITLES[group],
                "unit": _spelled(units[group]),
                "first": median[0],
                "last": median[-1],
                "p95": p95[-1],
                "rounding": rounding,
                "ratio": ratio,
            }
        )
    return rows


def _summary(comparison: Comparison) -> str:
    """One sentence: how far apart, compared with rounding, and which side is faster."""
    rows = _rows(comparison)
    group = next((r for r in rows if r["name"].endswith("position")), rows[0] if rows else None)
    if group is None:
        return "The scene has no joints: there is nothing to compare."
    horizon = si(float(comparison.horizon_s[-1]), "s")
    text = (
        f"After {horizon} the median {group['name'].lower()} error is "
        f"{group['last']:.2g} {group['unit']}"
    )
    if group["rounding"] is not None:
        text += f"; float32 rounding of the initial state alone gives {group['rounding']:.2g}"
        text += f". {_verdict(group['ratio'], comparison)}"
    else:
        text += "."
    fast, slow = sorted((comparison.a, comparison.b), key=lambda s: -s.steps_per_s)
    ratio = fast.steps_per_s / slow.steps_per_s
    return f"{text} Here {fast.backend} is {ratio:.3g} times as fast as {slow.backend}."


_SAME, _CLOSE = 10.0, 1000.0
"""Error over rounding up to which two backends are called the same, and close."""


_FLOOR = 1e-6
"""SI units: what float32 rounds positions of some metres or radians to."""


def _beside_rounding(error: Sequence[float], rounding: Sequence[float]) -> float:
    """How many times the error of rounding, where over the horizon that is most: in the end, what
    scatters is as far apart from itself as from anything else."""
    return float(np.max(np.asarray(error) / np.maximum(rounding, _FLOOR)))


def _verdict(ratio: float, comparison: Comparison) -> str:
    """What the error means beside that of rounding."""
    a, b = comparison.a.backend, comparison.b.backend
    if ratio == 0:
        return f"{b} gives exactly what {a} gives."
    if ratio <= _SAME:
        return (
            f"{b} agrees with {a} as well as float32 allows in this scene: to within {_SAME:g} "
            f"times its rounding, and {_FLOOR:g} is the least that counts as rounding."
        )
    if ratio <= _CLOSE:
        return f"{b} agrees with {a} to {ratio:.2g} times what rounding does in this scene."
    return f"{b} and {a} differ: {ratio:.2g} times what rounding does in this scene."


def _spelled(unit: str) -> str:
    """A unit that depends on the joint, in words: `rad or m` is `rad (slides: m)`."""
    turning, either, sliding = unit.partition(" or ")
    return f"{turning} (slides: {sliding})" if either else unit


def _speed_note(comparison: Comparison) -> str:
    return (
        "Wall-clock time of this run on this machine, all episodes as one batch; kernel "
        "compilation and loading are left out. A GPU backend needs thousands of worlds to show "
        "its strength."
    )


def _error_chart(comparison: Comparison, group: str) -> Markup:
    unit = _spelled(metrics.layout(comparison.scene.model).units[group])
    drawn, axes = figures.figure()
    values = comparison.error[group]
    if comparison.rounding is not None:
        figures.band(
            axes, comparison.horizon_s, comparison.rounding[group], figures.C, "float32 rounding"
        )
    figures.band(axes, comparison.horizon_s, values, figures.B, comparison.b.backend)
    shown = [values] if comparison.rounding is None else [values, comparison.rounding[group]]
    figures.log_if_wide(axes, shown)
    axes.set(title=f"{_TITLES[group]} error", xlabel="time (s)", ylabel=unit)
    figures.legend(axes)
    return figures.to_svg(drawn, f"{_TITLES[group]} error over time")


def _worst_charts(comparison: Comparison) -> list[Markup]:
    """The elements that differ most in the worst episode, both sides over time."""
    world = comparison.worst_episode
    model = comparison.scene.model
    a, b = (side.trajectory.qpos[world] for side in (comparison.a, comparison.b))
    time = comparison.a.trajectory.time[world] - comparison.a.trajectory.initial.time[world]
    spread = np.nan_to_num(np.abs(b - a).max(axis=0), nan=np.inf)
    names = _qpos_names(model)
    chosen = np.argsort(-spread, kind="stable")[:_MAX_JOINTS]
    charts: list[Markup] = []
    sides = (comparison.a.backend, comparison.b.backend)
    for index in chosen:
        drawn, axes = figures.figure(height=2.2)
        if _identical_to_the_eye(a[:, index], b[:, index]):
            text = f"qpos {names[index]}: {sides[1]} less {sides[0]}"
            axes.plot(time, b[:, index] - a[:, index], color=figures.B)
        else:
            text = f"qpos {names[index]}"
            axes.plot(time, a[:, index], color=figures.A, label=sides[0])
            axes.plot(time, b[:, index], color=figures.B, label=sides[1], linestyle="--")
            figures.legend(axes)
        axes.set(title=text, xlabel="time (s)")
        charts.append(figures.to_svg(drawn, f"{text} over time"))
    return charts


def _identical_to_the_eye(a: Floats, b: Floats) -> bool:
    """Whether two lines in one chart would cover each other: then their difference is drawn."""
    apart, travel = float(np.abs(b - a).max(initial=0.0)), float(np.ptp(a)) if a.size else 0.0
    return apart < _LINE_WIDTH * travel


_LINE_WIDTH = 0.01
"""Of a line, as a share of a chart's height."""


def _qpos_names(model: mujoco.MjModel) -> list[str]:
    parts = {
        int(mujoco.mjtJoint.mjJNT_FREE): ("x", "y", "z", "qw", "qx", "qy", "qz"),
        int(mujoco.mjtJoint.mjJNT_BALL): ("qw", "qx", "qy", "qz"),
    }
    names: list[str] = []
    for joint in range(model.njnt):
        name = name_of(model, mujoco.mjtObj.mjOBJ_JOINT, joint, "joint")
        suffixes = parts.get(int(model.jnt_type[joint]))
        names += [f"{name}/{s}" for s in suffixes] if suffixes else [name]
    return names


def _state_charts(comparison: Comparison) -> list[Markup]:
    def energy(side: Side) -> Any:
        return side.energies.total

    def kinetic(side: Side) -> Any:
        return side.energies.kinetic

    def contacts(side: Side) -> Any:
        return np.where(side.energies.contacts >= 0, side.energies.contacts, np.nan)

    charts: list[Markup] = []
    for title, unit, values in (
        ("Mechanical energy", "J", energy),
        ("Kinetic energy", "J", kinetic),
        ("Contacts", "", contacts),
    ):
        drawn, axes = figures.figure()
        for side, colour, line in _drawn_sides(comparison):
            figures.band(
                axes, comparison.horizon_s, values(side), colour, side.backend, linestyle=line
            )
        axes.set(title=title, xlabel="time (s)", ylabel=unit)
        figures.legend(axes)
        charts.append(figures.to_svg(drawn, f"{title} of both sides over time"))
    return charts


def _drawn_sides(comparison: Comparison) -> tuple[tuple[Side, str, str], ...]:
    """Both sides with colour and line; the second dashed, as it may lie on the first."""
    return ((comparison.a, figures.A, "-"), (comparison.b, figures.B, "--"))


def _touching(comparison: Comparison) -> list[dict[str, Any]]:
    """Of each group of bodies that can touch, the deepest penetration of both sides."""
    rows: list[dict[str, Any]] = []
    for group in comparison.a.penetration.depth:
        row: dict[str, Any] = {"name": _spoken(group)}
        for name, side in (("a", comparison.a), ("b", comparison.b)):
            depth, deepest = side.penetration.depth[group], side.penetration.deepest[group]
            known = [values[np.isfinite(values)] for values in depth]  # an episode may be lost
            most = np.array([values.max() for values in known if values.size] or [np.nan])
            row[name] = {
                "median": float(np.median(most)),
                "p95": float(np.quantile(most, 0.95)),
                "worst": float(np.max(most)),
                "where": " and ".join(deepest.between) if deepest else "",
            }
        rows.append(row)
    return rows


def _spoken(group: str) -> str:
    """`robot-object`: robot and object."""
    return " and ".join(group.split("-")).capitalize()


def _penetration_charts(comparison: Comparison) -> list[Markup]:
    """Of the groups in which anything overlaps, in millimetres."""
    charts: list[Markup] = []
    for group in comparison.a.penetration.depth:
        sides = (comparison.a, comparison.b)
        if not any(side.penetration.deepest[group] for side in sides):
            continue
        drawn, axes = figures.figure()
        title = f"Penetration: {_spoken(group).lower()}"
        for side, colour, line in _drawn_sides(comparison):
            depth = side.penetration.depth[group] * 1e3
            figures.band(axes, comparison.horizon_s, depth, colour, side.backend, linestyle=line)
        axes.set(title=title, xlabel="time (s)", ylabel="mm")
        figures.legend(axes)
        charts.append(figures.to_svg(drawn, f"{title} of both sides over time"))
    return charts


_QUANTITIES = {"position": ("mm", 1e3), "rotation": ("°", float(np.rad2deg(1.0)))}
"""Of predicted intervals: the unit that a chart shows, and how many there are in an SI unit."""


def _interval_charts(comparison: Comparison) -> list[Markup]:
    """Predicted intervals and true errors of every frame."""
    charts: list[Markup] = []
    for name, found in comparison.intervals.items():
        backend, colour = (
            (comparison.a.backend, figures.A) if name == "a" else (comparison.b.backend, figures.B)
        )
        for number, (_, frame) in enumerate(found.intervals.frames):
            for quantity, (unit, many) in _QUANTITIES.items():
                error = found.error(quantity)[..., number] * many
                width = found.predicted(quantity)[..., number] * many
                held = found.held(quantity)[..., number]
                drawn, axes = figures.figure()
                label = f"{100 * found.intervals.level:g} % interval of {backend}"
                figures.band(axes, comparison.horizon_s, width, figures.C, label)
                figures.band(axes, comparison.horizon_s, error, colour, "true error")
                figures.log_if_wide(axes, [error, width])
                share = 100 * np.nanmean(held) if np.isfinite(held).any() else np.nan
                title = f"{frame}, {quantity}: {share:.0f} % held"
                axes.set(title=title, xlabel="time (s)", ylabel=unit)
                figures.legend(axes)
                alt = f"Predicted intervals and true errors of {frame}, {quantity}, over time"
                charts.append(figures.to_svg(drawn, alt))
    return charts


def _film(comparison: Comparison, renderer: str) -> tuple[str | None, str]:
    """The worst episode as a data URI, or None and why not.

    Both sides next to each other; with a renderer other than MuJoCo's the second side as MuJoCo
    and as that renderer shows it, and how far they are apart.
    """
    try:
        if renderer == _MUJOCO:
            films = [_frames(comparison, s, _MUJOCO) for s in (comparison.a, comparison.b)]
        else:
            films = [_frames(comparison, comparison.b, name) for name in (_MUJOCO, renderer)]
            films.append(video.difference(*films))
    except RenderingUnavailableError as error:
        return None, str(error)
    except OrbiSimError as error:
        return None, f"rendering failed: {error}"
    return video.data_uri(video.side_by_side(*films), _FPS), ""


def _frames(comparison: Comparison, side: Side, name: str) -> list[video.Frames]:
    """The worst episode of one side, by one renderer."""
    world = comparison.worst_episode
    renderer = make_renderer(name, comparison.scene)
    try:
        return video.frames_of(
            renderer,
            side.trajectory.time[world],
            side.trajectory.qpos[world],
            dataclasses.replace(side.trajectory.initial)[world],
            _FPS,
            camera=_camera(comparison.scene.model),
            **_SIZE,
        )
    finally:
        renderer.close()


def _camera(model: mujoco.MjModel) -> int:
    """The first camera of the scene, or the free camera."""
    return 0 if model.ncam else -1
