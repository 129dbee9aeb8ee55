"""`orbisim infer`."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import click

from orbisim.cli.common import emit_json, engine_command, json_option, note, scene_options
from orbisim.errors import (
    InputError,
    MissingDependencyError,
    RecordingError,
    UnsupportedSceneError,
)

_BLIND = 0.9
"""Share of the prior's spread from which on a film says next to nothing of a number."""


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
    help="A vision checkpoint with StaInf. Default: the zoo's for the scene, if there is one.",
)
@click.option(
    "--refine/--no-refine",
    default=True,
    show_default=True,
    help="Fit each frame by analysis by synthesis.",
)
@click.option(
    "--fit",
    "opened",
    default="",
    help="What is not known of the objects: sizes, colors or sizes,colors. They are found from "
    "what the network reads and the frames themselves.",
)
@click.option("--camera", default="", help="Name or number of the camera. Default: the first.")
@click.option(
    "--pixels",
    default=128,
    show_default=True,
    type=click.IntRange(32, 1024),
    help="Height and width of the frames that are fitted.",
)
@json_option
@scene_options()
@engine_command
def command(
    video: Path,
    scene: str,
    out: Path,
    checkpoint: Path | None,
    refine: bool,
    opened: str,
    camera: str,
    pixels: int,
    as_json: bool,
) -> None:
    """Read the states of robot and objects off VIDEO; write them as a recording.

    A network (StaInf) reads joints and poses off each frame; then states are fitted to the frames
    by drawing the scene as it is declared, each frame from the one before. Of a scene that no
    network was trained on, joints start where the first frame is drawn best, and objects from where
    it has their colours. The middle square of each frame is used.

    With `--fit`, sizes and colours of objects are not taken from SCENE but fitted, too; their
    values stand in the recording's metadata. An object's proportions stay as declared.

    Joints and objects have NaN where a frame does not show them. The recording has positions alone:
    `replay` and `diagnose` differentiate and smooth them. Controls of position servos follow from
    the motion of their joints.

    Where the checkpoint has a PhyInf, the metadata's `physics` has what the motion says of the
    table's friction and the objects' densities, with 95 % intervals.
    """
    if not video.is_file():
        raise InputError(f"{video}: no such file; expected a video (.mp4, .avi, ...)")
    import numpy as np

    from orbisim.cameras import camera_number
    from orbisim.recording.servo import with_controls
    from orbisim.scene import load_scene, visible

    try:
        from orbisim_diffusion import zoo
        from orbisim_diffusion.estimate import infer, load_inference, read_frames, read_video
        from orbisim_diffusion.estimate_physics import has_physics, infer_physics, load_physics
        from orbisim_diffusion.looks import LookFitter, fit_looks
        from orbisim_diffusion.own import squares
        from orbisim_diffusion.refine import Refiner
        from orbisim_diffusion.tracking import follow, reading, recording_of
    except ImportError as error:
        raise MissingDependencyError("orbisim infer", "learned", str(error)) from error
    free = {part.strip() for part in opened.split(",") if part.strip()}
    if free - {"sizes", "colors"}:
        raise InputError(f"--fit {opened}: expected sizes, colors or sizes,colors")
    if free and not refine:
        raise InputError("--fit fits drawings to frames; leave --no-refine out")
    loaded = load_scene(scene)
    if not loaded.model.ncam:
        raise InputError(f"{scene}: declares no camera; add one where the film's camera stood")
    number = camera_number(loaded.model, int(camera) if camera.isdigit() else camera or 0)
    network = None
    try:
        folder = checkpoint or zoo.find(loaded, visible.rows(loaded.model))
        network = load_inference(folder)
    except UnsupportedSceneError:
        if not refine:
            raise
        note("no network was trained on this scene: states are found by drawing it alone")
    if refine:
        refiner = Refiner(loaded, number, pixels)
        frames, times = read_video(video, pixels)
        read = None
        if network is not None:
            point, model = network
            small = squares(frames, point.config.size)
            read = reading(read_frames(small, point, model), len(refiner.scalar.qpos))
        looks = None
        if free:
            if read is None:
                raise InputError(
                    f"--fit {opened} starts from what a network reads, and none was trained on "
                    f"{scene}; train one (orbisim train inference) or declare sizes and colours"
                )
            fitter = LookFitter(refiner, "sizes" in free, "colors" in free)
            looks = fit_looks(fitter, frames, read)
        recording = recording_of(loaded, refiner, times, follow(refiner, frames, read), looks)
    else:
        assert network is not None
        point, model = network
        frames, times = read_video(video, point.config.size)
        recording = infer(loaded, frames, times, point, model)
    recording = with_controls(recording, loaded.model)
    physics = {}
    if network is not None and has_physics(folder):
        try:
            said = infer_physics(loaded, [recording], *load_physics(folder))
            physics = {name: one.to_json() for name, one in said.items()}
        except (UnsupportedSceneError, RecordingError) as error:
            note(f"densities and friction are not inferred: {error}")
        metadata = {**recording.metadata, "physics": physics}
        recording = dataclasses.replace(recording, metadata=metadata)
    recording.save(out)
    hidden = [
        name.removeprefix("xpos/")
        for name, values in recording.signals.items()
        if name.startswith("xpos/") and not np.isfinite(values).any()
    ]
    if hidden and not free:  # a task's episodes have looks of their own, not those of `task:push`
        note(
            f"warning: no frame shows {', '.join(hidden)} as {scene} declares it"
            + ("; if size or colour may be another: --fit sizes,colors" if network else "")
        )
    noise = recording.metadata["noise"]
    largest = {name: max(v) if isinstance(v, list) else v for name, v in noise.items()}
    result = {
        "schema": "orbisim.infer/1",
        "scene": scene,
        "recording": str(out),
        "frames": len(frames),
        "signals": sorted(recording.signals),
        "refined": refine,
        "noise" if refine else "errors_on_test_frames": largest,
        "not_seen": recording.metadata.get("not_seen", []),
        "looks": recording.metadata.get("looks", {}),
        "physics": physics,
        "notes": list(recording.notes),
    }
    if as_json:
        emit_json(result)
        return
    note(f"{out}: {len(frames)} frames, {', '.join(result['signals'])}")
    for line in recording.notes:
        note(line)
    for body, look in result["looks"].items():
        half, color = (" ".join(f"{v:.4g}" for v in look[name]) for name in ("half_size", "color"))
        note(f"{body}: half sizes {half} m, color {color}")
    for name, one in physics.items():
        low, high = one["ci95"]
        blind = one["spread"] > _BLIND * one["prior_spread"]
        known = " (hardly anything of it shows: what tasks draw)" if blind else ""
        note(f"{name}: {one['value']:.3g} {one['unit']}, 95 % {low:.3g} to {high:.3g}{known}")
    for gap in result["not_seen"]:
        what = gap.get("body") or "what the joints move"
        note(f"warning: {what} is not seen from {gap['from']:.3g} to {gap['to']:.3g} s")
