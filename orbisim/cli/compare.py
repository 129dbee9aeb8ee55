"""`orbisim compare`."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import click

from orbisim.cli.common import (
    device_option,
    emit_json,
    engine_command,
    json_option,
    note,
    print_table,
    scene_options,
    seed_option,
    writable_folder,
)


@click.command(
    "compare", epilog="Example: orbisim compare suite:cheetah-run --a mujoco --b warp --out report"
)
@click.argument("scene")
@click.option("--a", default="mujoco", show_default=True, help="The reference backend.")
@click.option("--b", default="warp", show_default=True, help="The backend to compare with it.")
@click.option("--episodes", default=16, show_default=True, help="Number of episodes.")
@click.option(
    "--horizon",
    type=float,
    default=None,
    help="Duration of an episode, s. Default: the task's, or 2.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=None,
    callback=writable_folder,
    help="Folder for report.html and .json.",
)
@click.option("--video/--no-video", default=True, help="Whether the report shows a video.")
@click.option(
    "--renderer",
    default="mujoco",
    show_default=True,
    help="Of the video; another one is shown beside MuJoCo's.",
)
@device_option
@seed_option
@json_option
@scene_options()
@engine_command
def command(
    scene: str,
    a: str,
    b: str,
    episodes: int,
    horizon: float | None,
    out: Path | None,
    video: bool,
    renderer: str,
    device: str | None,
    seed: int,
    as_json: bool,
) -> None:
    """Run the same initial states and controls through two backends.

    Prints the error over the horizon for each signal group, the energy and the speed of each side;
    with --out, writes a report with plots and side-by-side video.
    """
    from orbisim.agreement import EngineWarning
    from orbisim.compare import compare

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", EngineWarning)  # said below, in one line each
        result = compare(scene, a, b, count=episodes, horizon=horizon, seed=seed, device=device)
    for fault in result.faults:
        note(f"warning: {fault}")
    if out is not None:
        note(f"report: {result.report(out, video=video, renderer=renderer)}")
    summary = result.to_json()
    if as_json:
        emit_json(summary)
        return
    _print(summary)


def _print(summary: dict[str, Any]) -> None:
    times = summary["horizon_s"]
    picks = sorted({0, len(times) // 4, len(times) // 2, len(times) - 1})
    rounding = summary["rounding"] or {}
    print_table(
        f"{summary['scene']}: median error of {summary['b']['backend']} against "
        f"{summary['a']['backend']}, {summary['episodes']} episodes",
        (
            "signal group",
            "unit",
            *(f"{times[i]:.3g} s" for i in picks),
            "95 % at the end",
            "rounding",
        ),
        [
            (
                group,
                entry["unit"],
                *(_value(entry["median"][i]) for i in picks),
                _value(entry["p95"][-1]),
                _value(rounding[group]["median"][-1]) if group in rounding else "-",
            )
            for group, entry in summary["error"].items()
        ],
    )
    _print_penetration(summary)
    _print_uncertainty(summary)
    print_table(
        "\nSpeed",
        ("backend", "control steps/s", "one step of one world (ms)", "control step (ms)"),
        [
            (
                summary[side]["backend"],
                summary[side]["steps_per_s"],
                summary[side]["latency_s"] * 1e3,
                summary[side]["control_step_s"] * 1e3,
            )
            for side in ("a", "b")
        ],
    )
    if summary["diverged"]:
        note(f"warning: {summary['diverged']} of {summary['episodes']} episodes became non-finite")


def _print_penetration(summary: dict[str, Any]) -> None:
    sides = [summary[side]["backend"] for side in ("a", "b")]
    rows = [
        (group, *(1e3 * _deepest(summary["penetration"][side][group]) for side in ("a", "b")))
        for group in summary["penetration"]["a"]
    ]
    if rows:
        title = "\nDeepest penetration in all episodes (mm)"
        print_table(title, ("between", *sides), rows)


def _deepest(entry: dict[str, Any]) -> float:
    return entry["deepest"]["depth"] if entry["deepest"] else 0.0


def _print_uncertainty(summary: dict[str, Any]) -> None:
    for side in ("a", "b"):
        found = summary["uncertainty"][side]
        if found is None:
            continue
        print_table(
            f"\n{100 * found['level']:g} % intervals of {summary[side]['backend']}, medians and "
            "95 % at the end",
            ("frame", "unit", "interval", "95 %", "true error", "95 %", "held in all (%)"),
            [_interval_row(frame, what) for frame in found["frames"] for what in _QUANTITIES],
        )


_QUANTITIES = ("position", "rotation")


def _interval_row(frame: dict[str, Any], quantity: str) -> tuple[Any, ...]:
    entry = frame[quantity]
    ends = [_value(entry[w][k][-1]) for w in ("interval", "error") for k in ("median", "p95")]
    held = entry["covered_in_all"]
    return (
        f"{frame['name']}, {quantity}",
        entry["unit"],
        *ends,
        "nan" if held is None else 100 * held,
    )


def _value(value: float | None) -> float | str:
    return "nan" if value is None else value
