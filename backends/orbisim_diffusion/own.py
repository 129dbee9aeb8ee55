"""A user's own recordings as episodes: a video with states and a calibrated camera.

A folder holds `scene.xml` (or .urdf, .usd), `recording.npz` (or .csv, .parquet), `camera.json`
and `video.mp4`, or a folder `images`. `camera.json` has `pos` [3] (m), `rot` [3][3] (columns:
right, up, backward), `intrinsics` [3][3] (pixels of the video) and, if the video does not begin
with the recording, `start` (s); with images, `fps`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import numpy.typing as npt
from PIL import Image

from orbisim.cameras import Camera
from orbisim.errors import InputError
from orbisim.files.reading import read_json
from orbisim.recording import Recording, bind
from orbisim.scene import load_scene, visible

Arrays = dict[str, npt.NDArray[Any]]
_SCENES = ("scene.xml", "scene.urdf", "scene.usd", "scene.usda", "scene.usdz")
_RECORDINGS = ("recording.npz", "recording.csv", "recording.parquet")
_IMAGES = (".png", ".jpg", ".jpeg")
_MOST_FRAMES = 100_000
"""Of a video, whose frames are held in memory: an hour at 30 frames/s."""


def read_own(folder: Path, size: int) -> Arrays:
    """One folder as an episode (see `orbisim_diffusion.store.read_episode`).

    The middle square of each image is brought to `size` pixels.

    Raises:
      InputError: a file is missing, the calibration makes no sense, or the recording does not
        hold all joints while the video runs.
    """
    scene = load_scene(_first(folder, _SCENES))
    camera = read_json(folder / "camera.json")
    frames, fps = _video(folder, camera)
    times = _number(camera, "start", folder, 0.0) + np.arange(len(frames)) / fps
    qpos = _positions(folder, scene, times)
    poses = visible.poses(scene.model, qpos)
    height, width = frames.shape[1:3]
    square = min(height, width)
    lens = _lens(camera, folder, height, width, square)
    count = len(frames)
    return {
        "frames": squares(frames, size),
        "view_pos": np.tile(lens.pos.astype(np.float32), (count, 1)),
        "view_rot": np.tile(lens.rot.astype(np.float32), (count, 1, 1)),
        "lens": np.array([*lens.focal, *lens.offset], np.float32),
        "geoms": visible.rows(scene.model).astype(np.float32),
        "lights": visible.lights(scene.model).astype(np.float32),
        "pos": poses["geoms/pos"],
        "quat": poses["geoms/quat"],
    }


def _first(folder: Path, names: tuple[str, ...]) -> Path:
    for name in names:
        if (folder / name).exists():
            return folder / name
    raise InputError(f"{folder}: has none of {', '.join(names)}")


def _video(folder: Path, camera: dict[str, Any]) -> tuple[npt.NDArray[np.uint8], float]:
    """Frames [T, H, W, 3] and how many there are a second."""
    path = folder / "video.mp4"
    if path.exists():
        fps = float(iio.immeta(path, plugin="FFMPEG")["fps"])
        frames = list(bounded(iio.imiter(path, plugin="FFMPEG"), path))
    else:
        names = sorted(p for p in (folder / "images").glob("*") if p.suffix.lower() in _IMAGES)
        if not names:
            raise InputError(f"{folder}: has neither video.mp4 nor a folder of images")
        fps = _number(camera, "fps", folder, None)
        frames = list(bounded((iio.imread(name)[..., :3] for name in names), folder / "images"))
    if len({frame.shape for frame in frames}) != 1:
        raise InputError(f"{folder}: images of different sizes")
    return np.stack(frames).astype(np.uint8), fps


def bounded(frames: Iterator[Any], path: Path) -> Iterator[Any]:
    """The frames of a video; `InputError` where there are too many to hold."""
    for number, frame in enumerate(frames):
        if number >= _MOST_FRAMES:
            raise InputError(f"{path}: more than {_MOST_FRAMES} frames; cut it into pieces")
        yield frame


def _positions(folder: Path, scene: Any, times: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Coordinates [T, nq] at the frames' times, linear between samples."""
    path = _first(folder, _RECORDINGS)
    bound = bind(Recording.load(path), scene)
    time, qpos = np.asarray(bound.recording.time), np.asarray(bound.qpos)
    unknown = ~np.isfinite(qpos).all(1)
    if unknown.any():
        raise InputError(f"{path}: {int(unknown.sum())} samples do not give all joints")
    if times[0] < time[0] - 1e-6 or times[-1] > time[-1] + 1e-6:
        raise InputError(
            f"{path}: holds {time[0]:g} to {time[-1]:g} s; the video runs from {times[0]:g} to "
            f"{times[-1]:g} s (camera.json, start)"
        )
    return np.stack([np.interp(times, time, column) for column in qpos.T], axis=1)


def _lens(camera: dict[str, Any], folder: Path, height: int, width: int, square: int) -> Camera:
    where = folder / "camera.json"
    shapes = {"pos": (3,), "rot": (3, 3), "intrinsics": (3, 3)}
    values = {}
    for name, shape in shapes.items():
        try:
            values[name] = np.array(camera.get(name), np.float64)
        except (TypeError, ValueError):
            values[name] = np.zeros(0)
        if values[name].shape != shape or not np.isfinite(values[name]).all():
            raise InputError(f"{where}: {name} must be finite numbers of shape {list(shape)}")
    matrix = values["intrinsics"].copy()
    matrix[0, 2] -= (width - square) / 2
    matrix[1, 2] -= (height - square) / 2
    return Camera.from_intrinsics(values["pos"], values["rot"], matrix, square, square)


def squares(frames: npt.NDArray[np.uint8], size: int) -> npt.NDArray[np.uint8]:
    """The middle squares of images [T, H, W, 3] at another size: [T, size, size, 3]."""
    square = min(frames.shape[1:3])
    top, left = ((n - square) // 2 for n in frames.shape[1:3])
    cut = frames[:, top : top + square, left : left + square, :3]
    if square == size:
        return np.ascontiguousarray(cut)
    wanted = (size, size)
    return np.stack(
        [np.asarray(Image.fromarray(f).resize(wanted, Image.Resampling.LANCZOS)) for f in cut]
    )


def _number(camera: dict[str, Any], name: str, folder: Path, default: float | None) -> float:
    value = camera.get(name, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise InputError(f"{folder / 'camera.json'}: {name} must be a number; got {value!r}")
    return float(value)
