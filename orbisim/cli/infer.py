"""`orbisim infer`."""

from __future__ import annotations

from pathlib import Path

import click

from orbisim.cli.common import emit_json, engine_command, json_option, note, scene_options
from orbisim.errors import MissingDependencyError


@click.command(
    "infer",
    epilog="Example: orbisim infer video.mp4 --scene task:push --out seen.npz && "
    "orbisim replay task:push seen.npz",
)
@click.argument("video", type=click.Path(path_type=Path))
@click.option("--scene", required=True, help="The scene that the video shows.")
@click.option(
    "--out", required=True, type=click.Path(path_type=Path), help="The recording: .npz or .csv."
)
@click.option(
    "--checkpoint",
    default=None,
    type=click.Path(path_type=Path),
    help="A vision checkpoint with StaInf. Default: the zoo's for the scene.",
)
@json_option
@scene_options()
@engine_command
def command(video: Path, scene: str, out: Path, checkpoint: Path | None, as_json: bool) -> None:
    """Read the states of robot and objects off VIDEO; write them as a recording.

    The video must be taken by the camera that the checkpoint was trained with; the middle square
    of each frame is used. The recording has positions alone: `replay` and `diagnose` differentiate
    and smooth them. It has no controls, which no image shows.
    """
    from orbisim.scene import load_scene, visible

    try:
        from orbisim_diffusion import zoo
        from orbisim_diffusion.estimate import infer, load_inference, read_video
    except ImportError as error:
        raise MissingDependencyError("orbisim infer", "learned", str(error)) from error
    loaded = load_scene(scene)
    folder = checkpoint or zoo.find(loaded, visible.rows(loaded.model))
    point, model = load_inference(folder)
    frames, times = read_video(video, point.config.size)
    recording = infer(loaded, frames, times, point, model)
    recording.save(out)
    result = {
        "schema": "orbisim.infer/1",
        "scene": scene,
        "recording": str(out),
        "frames": len(frames),
        "signals": sorted(recording.signals),
        "errors_on_test_frames": recording.metadata["noise"],
    }
    if as_json:
        emit_json(result)
        return
    note(f"{out}: {len(frames)} frames, {', '.join(result['signals'])}")
