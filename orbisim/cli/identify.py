"""`orbisim identify`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

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
from orbisim.errors import MissingDependencyError

if TYPE_CHECKING:
    from orbisim.identification.learned import Guess
    from orbisim.recording import Recording


@click.command(
    "identify",
    epilog="Example: orbisim identify task:push push.npz --params friction:table,density:cube1",
)
@click.argument("scene")
@click.argument("recordings", metavar="RECORDING...", nargs=-1, required=True)
@click.option(
    "--params",
    required=True,
    help="friction, density, mass, damping, frictionloss, armature; NAME or NAME:TARGET, ...",
)
@click.option(
    "--backend",
    default="learned",
    show_default=True,
    help="learned, learned:PATH or learned:NAME of the zoo: gradients through a frozen model; "
    "mujoco: mujoco.sysid.",
)
@click.option(
    "--guess",
    default="",
    metavar="CHECKPOINT",
    help="Begin from, and weigh against, what the PhyInf of a vision checkpoint reads off the "
    "recordings: its folder, or zoo for the one that fits SCENE.",
)
@click.option("--window", default=1.0, show_default=True, help="Duration of a free run, s.")
@click.option("--steps", default=12, show_default=True, help="Steps of the search at most.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=None,
    callback=writable_folder,
    help="Folder for identified.json and scene/scene.xml.",
)
@map_option
@device_option
@json_option
@scene_options()
@engine_command
def command(
    scene: str,
    recordings: tuple[str, ...],
    params: str,
    backend: str,
    guess: str,
    window: float,
    steps: int,
    out: Path | None,
    mapping: Path | None,
    device: str | None,
    as_json: bool,
) -> None:
    """Fit descriptors of SCENE to each RECORDING: values with 95 % intervals, and a patched scene.

    Windows of the recordings start from recorded states and run free; the descriptors that bring
    them closest are searched, by gradients through a learned model that stays as it is, or by
    mujoco.sysid. What no window shows keeps its declared value (with `--guess` the network's), with
    a wide interval.
    """
    from orbisim.identification import identify
    from orbisim.recording import load_recordings
    from orbisim.report.notes import merged

    with notes_held_back() as notes:
        loaded = load_recordings(recordings, mapping)
        result = identify(
            scene,
            loaded,
            params,
            backend=backend,
            window=window,
            steps=steps,
            device=device or "cpu",
            guess=_guessed(scene, loaded, guess) if guess else None,
        )
    for text in merged(notes):
        note(f"note: {text}")
    if out is not None:
        note(f"written: {result.save(out)}")
    if as_json:
        emit_json(result.to_json())
        return
    rows = zip(result.parameters, result.values, result.low, result.high, strict=True)
    print_table(
        f"{result.scene}, {result.windows} windows, {result.backend}, {result.seconds:.1f} s",
        ("parameter", "declared", "identified", "95 % from", "to", "unit"),
        [(p.label, p.declared, v, a, b, p.unit) for p, v, a, b in rows],
    )
    click.echo(
        f"\nrms of free runs on MuJoCo: {result.before:.4g} before, {result.after:.4g} after"
    )


def _guessed(scene: str, recordings: Sequence[Recording], checkpoint: str) -> Guess:
    """What a network says of the recordings."""
    from orbisim.scene import load_scene, visible

    try:
        from orbisim_diffusion import zoo
        from orbisim_diffusion.estimate_physics import guesses, infer_physics, load_physics
    except ImportError as error:
        raise MissingDependencyError("--guess", "learned", str(error)) from error
    loaded = load_scene(scene)
    folder = zoo.find(loaded, visible.rows(loaded.model)) if checkpoint == "zoo" else checkpoint
    return guesses(infer_physics(loaded, recordings, *load_physics(folder)))
