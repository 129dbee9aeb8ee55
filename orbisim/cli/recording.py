"""`orbisim recording`."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orbisim.cli.common import (
    emit_json,
    engine_command,
    json_option,
    note,
    print_table,
    scene_options,
    trusted_option,
)

if TYPE_CHECKING:
    from orbisim.recording.summary import ColumnFacts, Summary


@click.group("recording", epilog="Example: orbisim recording info log.csv --json")
def command() -> None:
    """Look into a log, and say which of its columns are which signals.

    A log is an .npz, .csv, .parquet or HDF5 file, a ROS bag, an MCAP file or a LeRobot folder.
    """


@command.command("info", epilog="Example: orbisim recording info log.csv --scene arm.xml")
@click.argument("log")
@click.option("--scene", default=None, help="Compare with what this scene can have recorded.")
@click.option(
    "--map", "mapping", type=click.Path(path_type=Path), default=None,
    help="A map: show the signals that it makes of the log.",
)  # fmt: skip
@trusted_option
@json_option
@scene_options()
@engine_command
def info(log: str, scene: str | None, mapping: Path | None, trusted: bool, as_json: bool) -> None:
    """Print what LOG holds: columns, units, rates, gaps, noise, and what looks odd."""
    from orbisim.recording.files import opened
    from orbisim.recording.mapping import SignalMap
    from orbisim.recording.summary import summarize
    from orbisim.scene import load_scene

    loaded = None if scene is None else load_scene(scene, trusted=trusted)
    chosen = None if mapping is None else SignalMap.load(mapping)
    summary = summarize(opened(log), loaded, chosen)
    if as_json:
        emit_json(summary.to_json())
    else:
        _print(summary)


@command.command(
    "init", epilog="Example: orbisim recording init log.csv --scene arm.xml --out map.yaml"
)
@click.argument("log")
@click.option("--scene", required=True, help="The scene whose signals the log holds.")
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("map.yaml"), show_default=True,
    help="The map to write; - is standard output.",
)  # fmt: skip
@click.option("--force", is_flag=True, help="Write over a file that exists.")
@trusted_option
@json_option
@scene_options()
@engine_command
def init(log: str, scene: str, out: Path, force: bool, trusted: bool, as_json: bool) -> None:
    """Write a first map of LOG: which of its columns are which signals of the scene.

    Columns are matched by the likeness of their names. Check every line, then use the map with
    --map.
    """
    from orbisim.errors import InputError
    from orbisim.files.writing import writing
    from orbisim.recording.files import opened
    from orbisim.recording.template import propose
    from orbisim.scene import load_scene

    proposal = propose(opened(log), load_scene(scene, trusted=trusted))
    shown = str(out) == "-"
    if not shown:
        if out.exists() and not force:
            raise InputError(f"{out}: exists; name another file with --out, or use --force")
        with writing(out) as part:
            part.write_text(proposal.text, encoding="utf-8")
        words = shlex.join(["orbisim", "replay", scene, log, "--map", str(out)])
        note(f"map: {out} (check every line, then: {words})")
    if as_json:
        emit_json(
            {
                "schema": "orbisim.recording.init/1",
                "map": None if shown else str(out),
                "matched": dict(proposal.matched),
                "unmatched": list(proposal.unmatched),
            }
        )
    elif shown:
        click.echo(proposal.text, nl=False)


def _print(summary: Summary) -> None:
    print_table(
        f"{summary.source}\n\nClocks",
        ("group", "column", "samples", "duration (s)", "rate (Hz)", "gaps", "longest (s)"),
        [
            (c.group or "-", c.column or "-", c.samples, c.duration_s, c.rate_hz, c.gaps,
             c.longest_s)
            for c in summary.clocks
        ],
    )  # fmt: skip
    print_table(
        "\nColumns",
        ("column", "unit", "signal", "from", "to", "noise", "step", "missing"),
        [_row(fact) for fact in summary.columns],
    )
    if summary.unreadable:
        click.echo(f"\nNot numbers: {', '.join(map(repr, summary.unreadable))}")
    for text in summary.suspicions:
        note(f"odd: {text}")
    for text in summary.notes:
        note(f"note: {text}")


def _row(fact: ColumnFacts) -> tuple[object, ...]:
    numbers = (fact.lowest, fact.highest, fact.noise, fact.step)
    name = fact.name + (f" [T, {fact.shape[1]}]" if len(fact.shape) == 2 else "")
    return (
        name,
        fact.unit or "-",
        fact.signal or "-",
        *("-" if value != value else value for value in numbers),
        f"{fact.missing:.0%}",
    )
