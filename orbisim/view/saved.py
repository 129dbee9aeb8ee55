"""Saved trajectories: as a file, or served with a time slider."""

from __future__ import annotations

import contextlib
import threading
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from orbisim.errors import InputError
from orbisim.files.writing import write_text
from orbisim.scene import Scene
from orbisim.trajectory import Trajectory
from orbisim.view.animation import Frames, animate, frames_of
from orbisim.view.drawing import Drawing
from orbisim.view.options import GHOST, ViewOptions
from orbisim.view.page import Caption, LegendEntry, page
from orbisim.view.server import Server, announce
from orbisim.view.stage import stage

LARGE = 50 * 10**6
"""Size of a page, in bytes, beyond which it comes with a warning."""

Copies = list[tuple[Drawing, Frames]]


def trajectory_html(
    scene: Scene,
    trajectory: Trajectory | None,
    *,
    ghost: Trajectory | None = None,
    ghost_scene: Scene | None = None,
    world: int = 0,
    ghost_world: int | None = None,
    fps: float = 30.0,
    title: str | None = None,
    labels: tuple[str, str] = ("trajectory", "ghost"),
    options: ViewOptions | None = None,
) -> str:
    """A trajectory as one HTML page with a time slider, which works without a network.

    The page starts by playing, again and again; opened with `#t=1.5` behind its address it stands
    still at 1.5 s. What is not finite is not shown: the animation ends before it, and the page
    and a warning say so.

    Args:
      scene: the scene.
      trajectory: what to show; None for the scene as it is at reset.
      ghost: another trajectory, overlaid in one transparent colour; only what can move is shown.
      ghost_scene: the scene of the ghost, if it is another one.
      world, ghost_world: which world of each; the ghost's is `world` if None.
      fps: frames stored per second; the states recorded nearest to them are taken.
      title: of the page; the scene's name if None.
      labels: what the two trajectories are called in the legend.
      options: what to show.

    Raises:
      InputError: a trajectory does not fit its scene, or its first state is not finite.
      MissingDependencyError: `options.max_faces` needs a package that is not installed.
    """
    if ghost is not None and trajectory is None:
        raise InputError("a ghost needs a trajectory to be compared with")
    options = options or ViewOptions()
    drawing = Drawing(scene.model, options)
    copies: Copies = []
    if trajectory is not None:
        copies.append((drawing, frames_of(scene, trajectory, world=world, fps=fps)))
    if ghost is not None:
        other = ghost_scene or scene
        number = world if ghost_world is None else ghost_world
        frames = frames_of(other, ghost, world=number, fps=fps, what="ghost's trajectory")
        copies.append((Drawing(other.model, options, GHOST), frames))
    commands = [*stage(drawing.kinematics, drawing.parts, options)]
    for copy, frames in copies:
        copy.place(frames.qpos[0], frames.memory)
    for copy in [copy for copy, _ in copies] or [drawing]:
        commands += copy.create()
    if any(frames.duration > 0 for _, frames in copies):
        commands += animate(copies)
    text = page(commands, _caption(title or scene.name, copies, labels), options.theme)
    if len(text) > LARGE:
        warnings.warn(
            f"the page has {len(text) / 1e6:.0f} MB; a lower fps, or max_faces for large meshes, "
            "makes it smaller",
            stacklevel=2,
        )
    return text


def save_html(
    path: str | Path, scene: Scene, trajectory: Trajectory | None, **choices: Any
) -> Path:
    """Writes `trajectory_html(scene, trajectory, **choices)` to a file and returns its path.

    Raises:
      InputError: the file cannot be written, or see `trajectory_html`.
    """
    text = trajectory_html(scene, trajectory, **choices)
    write_text(path, text)
    return Path(path)


def view_trajectory(
    scene: Scene,
    trajectory: Trajectory | None,
    *,
    port: int | None = None,
    open_browser: bool = False,
    on_ready: Callable[[str], None] | None = None,
    duration: float | None = None,
    **choices: Any,
) -> None:
    """Serves `trajectory_html(scene, trajectory, **choices)` until Ctrl-C.

    Args:
      port: of the server; None for 7000, or any free one if that is taken.
      open_browser: whether to open the page in a browser.
      on_ready: called with the page's address; prints it if None.
      duration: how long to serve it, s; None for until Ctrl-C.

    Raises:
      InputError: the port is taken, or see `trajectory_html`.
    """
    text = trajectory_html(scene, trajectory, **choices)
    with Server(text, port=port) as server, contextlib.suppress(KeyboardInterrupt):
        announce(server, on_ready, open_browser)
        threading.Event().wait(duration)


def _caption(title: str, copies: Copies, labels: tuple[str, str]) -> Caption:
    named = list(zip(copies, labels, strict=False))
    notices = [text for (_, frames), label in named if (text := _notice(frames, label))]
    for text in notices:
        warnings.warn(text, stacklevel=3)
    legend = [LegendEntry(label, drawing.look.tint) for (drawing, _), label in named]
    return Caption(title, legend if len(legend) > 1 else (), notices)


def _notice(frames: Frames, label: str) -> str:
    """What there is to say about what is not shown; empty for nothing."""
    if frames.stopped_at is not None:
        return (
            f"{label}: the state is not finite from {frames.stopped_at:.4g} s on; "
            "it is shown up to there"
        )
    if frames.duration == 0:
        return f"{label}: has no steps; only its initial state is shown"
    return ""
