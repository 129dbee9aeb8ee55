"""`orbisim sim`."""

from __future__ import annotations

import math
import time
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
    warn_undriven,
    writable_folder,
)
from orbisim.errors import InputError, MissingDependencyError
from orbisim.files.writing import make_folder


@click.command(
    "sim",
    epilog="Example: orbisim sim suite:cheetah-run --backend warp --renderer mujoco --out out",
)
@click.argument("scene")
@click.option("--backend", default="mujoco", show_default=True, help="Name of the backend.")
@click.option("--renderer", default=None, help="Name of a renderer, for a video. Default: none.")
@click.option("--duration", default=2.0, show_default=True, help="Simulated time, s.")
@click.option("--worlds", default=1, show_default=True, help="Number of worlds at once.")
@click.option(
    "--controls",
    type=click.Choice(["zero", "random", "policy"]),
    default=None,
    help="What the actuators get. Default: a task's policy, if it has one; else zero.",
)
@click.option(
    "--policy",
    type=click.Path(path_type=Path),
    default=None,
    help="Policy that acts: a folder (orbisim train policy), or a name of the zoo (push).",
)
@click.option("--camera", default="", help="Name or number of a camera. Default: the first.")
@click.option("--size", default="480x640", show_default=True, help="Height x width of the video.")
@click.option("--fps", default=30.0, show_default=True, help="Frames for each simulated second.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=None,
    callback=writable_folder,
    help="Folder for the files.",
)
@device_option
@seed_option
@json_option
@scene_options()
@engine_command
def command(
    scene: str,
    backend: str,
    renderer: str | None,
    duration: float,
    worlds: int,
    controls: str | None,
    policy: Path | None,
    camera: str,
    size: str,
    fps: float,
    out: Path | None,
    device: str | None,
    seed: int,
    as_json: bool,
) -> None:
    """Simulate SCENE; write trajectory.npz and, with a renderer, video.mp4 to --out."""

    from orbisim.episodes import check_size, episodes
    from orbisim.registry import make_backend

    if not 0 < duration < math.inf or worlds < 1:
        raise InputError(
            f"need a duration above 0 and at least one world; got {duration}, {worlds}"
        )
    if not 0 < fps < math.inf:
        raise InputError(f"--fps is a number of frames for each second, above 0; got {fps}")
    height, width = _size(size)
    agent = _agent(policy, scene, controls) if policy else None
    setup = agent.episodes(worlds, seed) if agent else episodes(scene, worlds, seed)
    engine = make_backend(
        backend, setup.scene, nworld=worlds, device=None if backend == "mujoco" else device
    )
    step = engine.timestep
    check_size(setup.scene.model, worlds, duration / step)
    sequence = None if agent else _controls(setup, controls, duration, step, seed)
    film = _Film(renderer, setup.scene, camera, height, width, fps) if renderer else None
    started = time.perf_counter()
    if agent:
        trajectory = agent.act(engine, setup, duration)
    else:
        trajectory = _rollout(engine, setup.initial, sequence)
    elapsed = time.perf_counter() - started
    files = _write(out, trajectory, film, scene, backend, seed)
    lost = int((trajectory.diverged_at >= 0).sum())
    result = {
        "schema": "orbisim.sim/1",
        "scene": scene,
        "backend": backend,
        "worlds": worlds,
        "steps": trajectory.nstep,
        "timestep_s": step,
        "duration_s": trajectory.nstep * step,
        "wall_s": elapsed,
        "steps_per_s": worlds * trajectory.nstep / elapsed,
        **(agent.result(trajectory) if agent else {}),
        "diverged": lost,
        "files": [str(path) for path in files],
    }
    if as_json:
        emit_json(result)
    else:
        shown = {**result, "files": ", ".join(result["files"]) or "none (--out DIR keeps them)"}
        print_table("", ("", "value"), [(k, v) for k, v in shown.items() if k != "schema"])
    if lost:
        note(f"warning: {lost} of {worlds} worlds became non-finite")


def _controls(setup: Any, kind: str | None, duration: float, step: float, seed: int) -> Any:
    """The controls [worlds, T, nu] of a kind."""
    import numpy as np

    from orbisim.episodes import Episodes

    scripted = type(setup) is not Episodes
    if kind == "policy" and not scripted:
        raise InputError("only tasks (task:push) have a policy; use --controls random")
    if kind == "random":
        warn_undriven(setup.scene.model.nu, setup.scene.source)
    plain = Episodes(setup.scene, setup.initial)
    if kind == "policy" or (kind is None and scripted):
        return setup.controls(duration, step, seed)
    sequence = plain.controls(duration, step, seed)
    return sequence if kind == "random" else np.zeros_like(sequence)


def _agent(folder: Path, scene: str, controls: str | None) -> Any:
    """A policy that acts in the scene."""
    if controls is not None:
        raise InputError("--policy and --controls exclude each other")
    try:
        from orbisim_policies.agent import Agent
    except ImportError as error:
        raise MissingDependencyError("a policy", "learned", str(error)) from error
    return Agent.of(folder, scene)


def _size(text: str) -> tuple[int, int]:

    try:
        height, width = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise InputError(f"--size is height x width, such as 480x640; got {text!r}") from None
    if height < 2 or width < 2 or height % 2 or width % 2:
        raise InputError(f"--size must be even numbers of pixels; got {text!r}")
    return height, width


def _rollout(engine: Any, initial: Any, controls: Any) -> Any:
    import numpy as np

    from orbisim.compare import join
    from orbisim.host.progress import track

    chunks = np.array_split(np.arange(controls.shape[1]), min(50, controls.shape[1]))
    pieces, state = [], initial
    for chunk in track(chunks, f"simulating with {engine.name}"):
        pieces.append(engine.rollout(state, controls[:, chunk]))
        state = pieces[-1].final
    return join(initial, controls, pieces)


class _Film:
    """Makes the renderer before the simulation runs, so that a missing one is noticed at once."""

    def __init__(
        self, renderer: str, scene: Any, camera: str, height: int, width: int, fps: float
    ) -> None:
        from orbisim.registry import make_renderer

        self._renderer = make_renderer(renderer, scene)
        chosen: int | str = 0 if scene.model.ncam else -1
        if camera:
            chosen = int(camera) if camera.lstrip("-").isdigit() else camera
        self._options = {"camera": chosen, "height": height, "width": width}
        self._fps = fps

    def write(self, path: Path, trajectory: Any) -> None:
        from orbisim.report import video

        frames = video.frames_of(
            self._renderer,
            trajectory.time[0],
            trajectory.qpos[0],
            trajectory.initial[0],
            self._fps,
            **self._options,
        )
        video.write_video(path, frames, self._fps)


def _write(
    out: Path | None, trajectory: Any, film: _Film | None, scene: str, backend: str, seed: int
) -> list[Path]:
    if out is None and film is None:
        return []
    folder = out or Path()
    make_folder(folder)
    files = [folder / "trajectory.npz"]
    trajectory.save(files[0], scene=scene, backend=backend, seed=seed)
    if film is not None:
        files.append(folder / "video.mp4")
        film.write(files[1], trajectory)
    return files
