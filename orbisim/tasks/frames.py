"""Camera images of an episode."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError, UnknownNameError
from orbisim.registry import make_renderer
from orbisim.scene import Scene
from orbisim.state import State
from orbisim.tasks.episode import Episode


@dataclasses.dataclass(frozen=True)
class Camera:
    """Which images to record.

    Attributes:
      name: of the scene's camera. size: height and width, pixels.
    """

    name: str
    size: int = 128

    def __post_init__(self) -> None:
        if not 8 <= self.size <= 2048:
            raise InputError(f"--size is 8 to 2048 pixels; got {self.size}")


def check_camera(scene: Scene, camera: Camera) -> None:
    """Raises `UnknownNameError` if the scene has no such camera."""
    known = [scene.model.camera(i).name for i in range(scene.model.ncam)]
    if camera.name not in known:
        raise UnknownNameError("camera", camera.name, known)


def with_frames(episode: Episode, scene: Scene, camera: Camera) -> Episode:
    """The episode with `frames/<camera>` [T+1, size, size, 3] added."""
    renderer = make_renderer("mujoco", scene)
    images = [_image(renderer, episode, t, camera) for t in range(episode.steps + 1)]
    renderer.close()
    arrays = {**episode.arrays, f"frames/{camera.name}": np.stack(images)}
    return dataclasses.replace(episode, arrays=arrays)


def _image(renderer: Any, episode: Episode, t: int, camera: Camera) -> npt.NDArray[np.uint8]:
    time, qpos, qvel, act = (
        episode.arrays[name][t : t + 1] for name in ("time", "qpos", "qvel", "act")
    )
    state = State(time, qpos, qvel, act)
    image: npt.NDArray[np.uint8] = renderer.render(
        state, camera=camera.name, height=camera.size, width=camera.size
    )
    return image
