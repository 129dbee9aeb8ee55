"""`orbisim diagnose`."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import click

from orbisim.cli.common import (
    emit_json,
    engine_command,
    json_option,
    map_option,
    note,
    notes_held_back,
    print_table,
    scene_options,
    seed_option,
    writable_folder,
)
from orbisim.errors import InputError


@click.command(
    "diagnose",
    epilog="Example: orbisim diagnose arm.xml run1.npz run2.npz run3.npz run4.npz --out diagnosis",
)
@click.argument("scene")
@click.argument("recordings", nargs=-1, metavar="RECORDING...")
@click.option(
    "--fleet",
    type=click.Path(path_type=Path),
    default=None,
    metavar="DIR",
    help="Instead of recordings: a folder with a folder of recordings for each robot. One "
    "diagnosis for each, and one table in --out; the same command goes on where it was stopped.",
)
@click.option(
    "--workers", type=int, default=None, help="Of --fleet: processes. Default: all cores."
)
@click.option("--ray", is_flag=True, help="Of --fleet: spread over a Ray cluster (or local).")
@click.option(
    "--held-out",
    "held_out",
    multiple=True,
    metavar="RECORDING",
    help="A recording that nothing may be fitted to (repeatable). Default: some are kept back.",
)
@click.option(
    "--window",
    type=float,
    help="Duration of a free run, s. Default: 0.5, or as long as 60 samples take where that has "
    "fewer than 30.",
)
@click.option(
    "--residual",
    type=click.Choice(["motion", "force"]),
    help="What to explain: free runs over windows, or the joint forces that the measured motion "
    "needs. Default: the forces of an arm of which all are recorded and many effects are missing.",
)
@click.option(
    "--backend",
    default="mujoco",
    show_default=True,
    help="Engine of the free-running errors; the search simulates with C MuJoCo.",
)
@click.option(
    "--effect",
    "effects",
    multiple=True,
    metavar="NAME",
    help="Consider only this effect of the catalogue (repeatable).",
)
@click.option("--most-effects", default=12, show_default=True, help="At most so many are added.")
@click.option(
    "--retune/--no-retune",
    default=True,
    help="Whether declared masses, dampings and gains may be off by a few percent.",
)
@click.option(
    "--learn-rest",
    is_flag=True,
    help="Where no effect explains the residual, fit a neural residual force to what is left. It "
    "is labelled as such, is never counted as an effect, and is kept only if it helps on windows "
    "that it was not trained on.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=None,
    callback=writable_folder,
    help="Folder for report.html, report.json and augmented/scene.xml.",
)
@click.option(
    "--patience",
    default=600.0,
    show_default=True,
    help="Seconds that it may take; it then ends with the best that it has.",
)
@map_option
@seed_option
@json_option
@scene_options()
@engine_command
def command(
    scene: str,
    recordings: tuple[str, ...],
    fleet: Path | None,
    workers: int | None,
    ray: bool,
    held_out: tuple[str, ...],
    window: float | None,
    residual: Literal["motion", "force"] | None,
    backend: str,
    effects: tuple[str, ...],
    most_effects: int,
    retune: bool,
    learn_rest: bool,
    out: Path | None,
    patience: float,
    mapping: Path | None,
    seed: int,
    as_json: bool,
) -> None:
    """Find the physical effect that SCENE lacks, from measurements of the real thing.

    With --fleet, of each robot of a fleet, and tell which robot differs from the others.

    Computes the residual, traces it to effects of the catalogue, adds them to the scene, and
    reports the free-running error before and after on data that nothing was fitted to.
    """
    from orbisim.diagnosis import Settings, diagnose
    from orbisim.effects import find
    from orbisim.recording import load_recordings

    _check_fleet(recordings, held_out, fleet, out, workers, ray, learn_rest)
    for name in effects:
        find(name)
    settings = Settings(
        effects=effects or None,
        most_effects=most_effects,
        retune=retune,
        patience=patience,
        seed=seed,
    )
    if fleet is not None and out is not None:
        from orbisim.fleet import Options, diagnose_fleet

        chosen = Options(window, residual, backend, settings, mapping)
        _print_fleet(
            diagnose_fleet(scene, fleet, out, chosen, workers=workers, ray=ray), out, as_json
        )
        return
    with notes_held_back():
        measured = load_recordings(recordings, mapping)
        unseen = load_recordings(held_out, mapping)
        result = diagnose(
            scene, measured, unseen or None, window=window, residual=residual,
            backend=backend, settings=settings, learn_rest=learn_rest, out=out,
        )  # fmt: skip
    if out is not None:
        note(f"report: {out / 'report.html'}")
        if result.patch.text:
            note(f"patch of your scene: {out / 'augmented' / 'patch.diff'}")
    if as_json:
        emit_json(result.to_json())
        return
    _print(result)


def _check_fleet(
    recordings: tuple[str, ...],
    held_out: tuple[str, ...],
    fleet: Path | None,
    out: Path | None,
    workers: int | None,
    ray: bool,
    learn_rest: bool,
) -> None:
    """Raises `InputError` unless there are recordings or a fleet, and options that fit."""
    if fleet is None:
        if not recordings:
            raise InputError("name recordings, or a folder of robots with --fleet DIR")
        if workers is not None or ray:
            raise InputError("--workers and --ray go with --fleet DIR")
        return
    if recordings or held_out or learn_rest:
        raise InputError(
            "--fleet DIR takes the recordings from its folders, and goes without RECORDING, "
            "--held-out and --learn-rest"
        )
    if out is None:
        raise InputError("--fleet needs --out DIR: that is where what is done is kept")


def _print_fleet(result: Any, out: Path, as_json: bool) -> None:
    """The table of robots by effects; outliers have an exclamation mark."""
    note(f"report: {out / 'report.html'}")
    if as_json:
        emit_json(result.to_json())
        return
    heads = [f"{r.effect} {r.target} ({r.unit})" for r in result.rows if r.effect != "left over"]
    lines = []
    for one in result.robots:
        shown = [r.cells.get(one.name) for r in result.rows if r.effect != "left over"]
        numbers = [
            "-" if c is None or not c.found else f"{c.value:.4g}{' !' * c.outlier}" for c in shown
        ]
        verdict = one.report["verdict"] if one.report else f"no diagnosis: {one.problem}"
        mark = "!" if one.name in result.outliers else ""
        lines.append((one.name, mark, *numbers, verdict))
    print_table("Fleet", ("robot", "outlier", *heads, "verdict"), lines)
    if result.outliers:
        click.echo(f"\n{', '.join(result.outliers)}: unlike the others.")


def _print(result: Any) -> None:
    from orbisim.diagnosis.wording import interval

    click.echo(result.sentence)
    for one in result.combinations:
        click.echo(f"{one.told[0].upper()}{one.told[1:]}.")
    if result.effects:
        rows = [
            (
                effect.effect,
                effect.target,
                name,
                estimate.value,
                interval(*estimate.ci95),
                estimate.unit,
            )
            for effect in result.effects
            for name, estimate in effect.parameters.items()
        ]
        print_table(
            "\nEffects",
            ("effect", "target", "parameter", "value", "95 % interval", "unit"),
            rows,
        )
    if result.retuned:
        factors = [(r.label, r.factor, interval(*r.ci95)) for r in result.retuned]
        print_table("\nDeclared parameters", ("parameter", "factor", "95 % interval"), factors)
    error = result.error
    what = error.get("name", f"free-running error over {error['window_s']:g} s").capitalize()
    print_table(
        f"\n{what} ({error['unit']}), noise {error['noise_floor']:.3g}",
        ("data", "before", "after"),
        [(kind, error[key]["before"], error[key]["after"])
         for kind, key in (("fitted", "fit"), ("held out", "held_out"))],
    )  # fmt: skip
    if result.rest is not None:
        _print_rest(result)
    if result.alternatives:
        print_table(
            "\nAlternatives",
            ("effect", "target", "reason"),
            [(a.effect, a.target, a.reason) for a in result.alternatives],
        )
    from orbisim.report.notes import merged

    for text in merged(result.notes):
        note(f"note: {text}")


def _print_rest(result: Any) -> None:
    """What became of `--learn-rest`."""
    rest = result.rest
    if rest.scene is None:
        click.echo(f"\nNo residual force was learned: {rest.reason}.")
        return
    joints = ", ".join(network.joint for network in rest.networks)
    print_table(
        f"\nLearned residual force at {joints} (not an effect): error ({result.error['unit']})",
        ("data", "without", "with"),
        [(kind, rest.error[key]["without"], rest.error[key]["with"])
         for kind, key in (("fitted", "fit"), ("held out", "held_out"))],
    )  # fmt: skip
