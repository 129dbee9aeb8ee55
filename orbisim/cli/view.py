"""`orbisim view`."""

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
    scene_options,
    seed_option,
    trusted_option,
    warn_undriven,
)
from orbisim.errors import InputError


@click.command(
    "view",
    epilog="Example: orbisim view suite:cheetah-run --backend warp; "
    "orbisim view robot.xml --trajectory a.npz --ghost b.npz --html both.html",
)
@click.argument("scene")
@click.option("--backend", default="mujoco", show_default=True, help="Simulates in real time.")
@click.option(
    "--trajectory",
    type=click.Path(path_type=Path),
    help="Show this saved trajectory, with a time slider, instead of simulating.",
)
@click.option(
    "--ghost",
    type=click.Path(path_type=Path),
    help="A second trajectory, overlaid and transparent.",
)
@click.option("--world", default=0, show_default=True, help="World of the trajectory.")
@click.option(
    "--controls",
    type=click.Choice(["zero", "random"]),
    default="zero",
    show_default=True,
    help="What the actuators get.",
)
@click.option(
    "--html",
    type=click.Path(path_type=Path),
    help="Write one file that needs no server, and stop. It plays the trajectory, or with "
    "--duration, --controls or --backend what is simulated now.",
)
@click.option(
    "--duration", type=float, help="Stop after so many seconds. Default: until Ctrl-C; of --html 2."
)
@click.option("--port", type=int, help="Of the local server. Default: a free one.")
@click.option("--browser/--no-browser", default=True, help="Whether to open a browser.")
@device_option
@seed_option
@trusted_option
@json_option
@scene_options()
@engine_command
def command(
    scene: str,
    backend: str,
    trajectory: Path | None,
    ghost: Path | None,
    world: int,
    controls: str,
    html: Path | None,
    duration: float | None,
    port: int | None,
    browser: bool,
    device: str | None,
    seed: int,
    trusted: bool,
    as_json: bool,
) -> None:
    """Show SCENE in the browser: any backend live, or saved trajectories with a time slider."""
    from orbisim.episodes import episodes
    from orbisim.trajectory import Trajectory
    from orbisim.view import save_html, view_live, view_trajectory

    if ghost is not None and trajectory is None:
        raise InputError("--ghost needs --trajectory: it is overlaid on one")
    setup = episodes(scene, 1, seed, **({} if _is_task(scene) else {"trusted": trusted}))
    if controls == "random":
        warn_undriven(setup.scene.model.nu, scene)
    shown, notes = Trajectory.load(trajectory) if trajectory else (None, {})
    other, ghost_notes = Trajectory.load(ghost) if ghost else (None, {})
    labels = tuple(_label(n, p) for n, p in ((notes, trajectory), (ghost_notes, ghost)) if p)
    saved: dict[str, Any] = {"ghost": other, "world": world, "title": scene}
    if len(labels) == 2:
        saved["labels"] = labels

    def ready(url: str) -> None:
        if as_json:
            emit_json({"schema": "orbisim.view/1", "scene": scene, "url": url})
        else:
            click.echo(f"{url}  (Ctrl-C to stop)")

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        if html is not None:
            if shown is None and (duration or controls != "zero" or backend != "mujoco"):
                shown = _simulated(setup, backend, controls, duration or 2.0, seed, device)
            path = save_html(html, setup.scene, shown, **saved)
            if as_json:
                emit_json({"schema": "orbisim.view/1", "scene": scene, "file": str(path)})
            else:
                click.echo(str(path))
        elif shown is not None:
            served: dict[str, Any] = {"port": port, "open_browser": browser, "duration": duration}
            view_trajectory(setup.scene, shown, on_ready=ready, **served, **saved)
        else:
            view_live(
                setup.scene,
                backend,
                None if controls == "zero" else setup.controls(duration or 60.0, 0.02, seed)[0],
                state=setup.initial,
                duration=duration,
                port=port,
                open_browser=browser,
                on_ready=ready,
                title=scene,
                device=None if backend == "mujoco" else device,
                nstep=1 if controls == "zero" else _held(setup.scene, 0.02),
            )
    for warning in caught:
        note(f"warning: {warning.message}")


def _simulated(
    setup: Any, backend: str, controls: str, duration: float, seed: int, device: str | None
) -> Any:
    """What a saved page plays: the trajectory of a backend, of one world."""
    import numpy as np

    from orbisim.registry import make_backend

    engine = make_backend(backend, setup.scene, device=None if backend == "mujoco" else device)
    sequence = setup.controls(duration, engine.timestep, seed)
    if controls == "zero":
        sequence = np.zeros_like(sequence)
    return engine.rollout(setup.initial, sequence)


def _is_task(scene: str) -> bool:
    return scene.partition(":")[0] in ("suite", "task") and ":" in scene


def _held(scene: Any, seconds: float) -> int:
    """Timesteps for which a control is held."""
    return max(1, round(seconds / float(scene.model.opt.timestep)))


def _label(notes: dict[str, Any], path: Path | None) -> str:
    return str(notes.get("backend") or (path.stem if path else ""))
