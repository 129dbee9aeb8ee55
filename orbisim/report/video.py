"""Videos: side by side, in a file or inside a page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import numpy.typing as npt

from orbisim.files.temporary import temporary_folder
from orbisim.files.writing import output_errors, writing
from orbisim.host.progress import track
from orbisim.renderer import Renderer
from orbisim.state import State

Frames = npt.NDArray[np.uint8]


def write_video(path: str | Path, frames: Sequence[Frames], fps: float) -> None:
    """Writes H.264 frames [height, width, 3] (even sizes) to an MP4 file.

    Raises:
      InputError: no file can be written there.
      OutputError: the disk is full, or ffmpeg failed.
    """
    with writing(path) as part:
        _encode(part, frames, fps)


def _encode(path: Path, frames: Sequence[Frames], fps: float) -> None:
    iio.imwrite(
        path,
        np.stack(frames),
        plugin="FFMPEG",
        fps=fps,
        codec="libx264",
        macro_block_size=2,
        output_params=["-pix_fmt", "yuv420p", "-crf", "26", "-movflags", "+faststart"],
        ffmpeg_log_level="error",
    )


def data_uri(frames: Sequence[Frames], fps: float) -> str:
    """The frames as a video inside a URI, for a page that needs no other file."""
    with temporary_folder() as folder, output_errors(folder / "video.mp4"):
        path = folder / "video.mp4"
        _encode(path, frames, fps)
        encoded = base64.b64encode(path.read_bytes()).decode()
    return f"data:video/mp4;base64,{encoded}"


def side_by_side(*films: Sequence[Frames]) -> list[Frames]:
    """Frames of several videos next to each other, with gaps."""
    gap = np.full((films[0][0].shape[0], 4, 3), 128, np.uint8)

    def joined(frames: tuple[Frames, ...]) -> Frames:
        parts = [part for frame in frames for part in (gap, frame)]
        return np.concatenate(parts[1:], axis=1)

    return [joined(frames) for frames in zip(*films, strict=True)]


def difference(a: Sequence[Frames], b: Sequence[Frames]) -> list[Frames]:
    """How far the frames of two videos are apart, four times as bright as it is."""
    return [
        np.minimum(4 * np.abs(x.astype(np.int16) - y), 255).astype(np.uint8)
        for x, y in zip(a, b, strict=True)
    ]


def frames_of(
    renderer: Renderer,
    time: npt.NDArray[np.float64],
    qpos: npt.NDArray[np.float64],
    base: State,
    fps: float,
    **options: Any,
) -> list[Frames]:
    """Renders one world's positions at a steady rate.

    Args:
      time: [T], s. qpos: [T, nq]; from the first row that is not finite on, the last image stays.
      base: a state of one world whose other fields are used.
      fps: frames for each second of simulated time.
      **options: passed to the renderer.
    """
    steps = np.searchsorted(time, np.arange(time[0], time[-1] + 1e-9, 1.0 / fps))
    frames: list[Frames] = []
    memory: dict[str, Any] = {}
    for step in track(np.minimum(steps, len(time) - 1), f"drawing with {renderer.name}"):
        if frames and not np.isfinite(qpos[step]).all():
            frames.append(frames[-1])
            continue
        state = base.replace(time=time[step : step + 1], qpos=qpos[step : step + 1])
        images, shown = renderer.observe(state.with_memory(**memory), **options)
        memory = dict(shown)  # a renderer may continue its own images
        frames.append(images[0])
    return frames
