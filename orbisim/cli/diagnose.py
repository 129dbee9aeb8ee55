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
    print_table,
    seed_option,
    writable_folder,
)


@click.command(
    "diagnose",
    epilog="Example: orbisim diagnose arm.xml run1.npz run2.npz run3.npz run4.npz --out diagnosis",
)
@click.argument("scene")
@click.argument("recordings", nargs=-1, required=True, metavar="RECORDING...")
@click.option(
    "--held-out",
    "held_out",
    multiple=True,
    metavar="RECORDING",
    help="A recording that nothing may be fitted to (repeatable). Default: some are kept back.",
)
@click.option("--window", default=0.5, show_default=True, help="Duration of a free run, s.")
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
@click.option("--most-effects", default=3, show_default=True, help="At most so many are added.")
@click.option(
    "--retune/--no-retune",
    default=True,
    help="Whether declared masses, dampings and gains may be off by a few percent.",
)
@click.option(
    "--learn-rest",
    is_flag=True,
    help="Where no effect explains the residual, fit a neural residual force to what is left. It "
    "is labelled as such, is never counted as an effect, and is kept only if it helps on held-out "
    "data.",
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
    help="Seconds after which no further effect is looked for.",
)
@map_option
@seed_option
@json_option
@engine_command
def command(
    scene: str,
    recordings: tuple[str, ...],
    held_out: tuple[str, ...],
    window: float,
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

    Computes the residual, traces it to effects of the catalogue, adds them to the scene, and
    reports the free-running error before and after on data that nothing was fitted to.
    """
    from orbisim.diagnosis import Settings, diagnose
    from orbisim.effects import find
    from orbisim.recording import load_recordings

    for name in effects:
        find(name)
    settings = Settings(
        effects=effects or None,
        most_effects=most_effects,
        retune=retune,
        patience=patience,
        seed=seed,
    )
    measured = load_recordings(recordings, mapping)
    unseen = load_recordings(held_out, mapping)
    result = diagnose(
        scene, measured, unseen or None, window=window, residual=residual,
        backend=backend, settings=settings, learn_rest=learn_rest, out=out,
    )  # fmt: skip
    if out is not None:
        note(f"report: {out / 'report.html'}")
    if as_json:
        emit_json(result.to_json())
        return
    _print(result)


def _print(result: Any) -> None:
    click.echo(result.sentence)
    if result.effects:
        rows = [
            (
                effect.effect,
                effect.target,
                name,
                estimate.value,
                f"{estimate.ci95[0]:.4g} to {estimate.ci95[1]:.4g}",
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
        factors = [
            (r.label, r.factor, f"{r.ci95[0]:.4f} to {r.ci95[1]:.4f}") for r in result.retuned
        ]
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
    for text in result.notes:
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
