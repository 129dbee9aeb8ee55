"""`orbisim replay`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orbisim.cli.common import (
    device_option,
    emit_json,
    engine_command,
    json_option,
    map_option,
    note,
    notes_held_back,
    print_table,
    scene_options,
    writable_folder,
)

if TYPE_CHECKING:
    from orbisim.replay import Replay


@click.command(
    "replay", epilog="Example: orbisim replay arm.xml monday.npz tuesday.csv --window 0.5 --out out"
)
@click.argument("scene")
@click.argument("recordings", metavar="RECORDING...", nargs=-1, required=True)
@click.option("--backend", default="mujoco", show_default=True, help="Name of the backend.")
@click.option(
    "--window",
    default=0.5,
    show_default=True,
    help="Duration of a free run, s; 0: from the first sample to the end.",
)
@click.option(
    "--velocities",
    type=click.Choice(["recorded", "smoothed"]),
    default="recorded",
    show_default=True,
    help="What windows start with: recorded velocities where there are any, or estimated ones.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=None,
    callback=writable_folder,
    help="Folder for report.html and .json.",
)
@map_option
@device_option
@json_option
@scene_options()
@engine_command
def command(
    scene: str,
    recordings: tuple[str, ...],
    backend: str,
    window: float,
    velocities: Any,
    out: Path | None,
    mapping: Path | None,
    device: str | None,
    as_json: bool,
) -> None:
    """Simulate windows of each RECORDING from its recorded states and compare.

    A recording is an .npz, .csv, .parquet or HDF5 file, a ROS bag, an MCAP file or a LeRobot folder
    with time and named signals; columns with other names are signals by a map. Each window starts
    from the recorded state and runs free under the recorded controls to its end.
    Prints the error of each signal; with --out, writes a report with plots.
    """
    from orbisim.recording import load_recordings
    from orbisim.replay import replay
    from orbisim.report.notes import merged

    with notes_held_back():
        loaded = load_recordings(recordings, mapping)
        result = replay(
            scene, loaded, backend=backend, window=window, device=device, velocities=velocities
        )
    for text in merged(result.notes):
        note(f"note: {text}")
    if out is not None:
        note(f"report: {result.report(out)}")
    if as_json:
        emit_json(result.to_json())
    else:
        _print(result)


def _print(result: Replay) -> None:
    print_table(
        _title(result),
        ("signal", "unit", "rms", "median", "95 %", "noise", "rms/noise"),
        [
            (
                name,
                error.unit,
                *(_value(x) for x in (error.rms, error.median, error.p95, error.noise)),
                _value(error.rms / result.noise_floor(name) if error.noise > 0 else float("nan")),
            )
            for name, error in result.signals.items()
        ],
    )
    overall = "unknown" if result.rms != result.rms else f"{result.rms:.4g} {result.unit}"
    click.echo(f"\noverall rms of joint positions: {overall}")


def _title(result: Replay) -> str:
    count = len(result.windows)
    span = f"{result.window_s:g} s" if result.window_s else "the whole recording"
    return f"{result.scene} on {result.backend}: {count} window{'s' * (count != 1)} of {span}"


def _value(value: float) -> float | str:
    """A number, or a dash if it is not known."""
    return "-" if value != value else value
