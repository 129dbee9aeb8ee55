"""Camera images of an episode, with what is needed to learn from them."""

from __future__ import annotations

import dataclasses
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.cameras import Camera as Viewpoint
from orbisim.cameras import Orbit, read_camera
from orbisim.errors import InputError, UnknownNameError
from orbisim.registry import make_renderer
from orbisim.scene import Scene, visible
from orbisim.state import State
from orbisim.tasks.episode import Episode
from orbisim.tasks.sampling import stream

RANDOM = "random"
"""Instead of a camera's name: one drawn anew for each episode."""
_DRAW = 7
"""Number of the random stream of cameras; scene and policy have others."""
_BACKGROUND = -1  # no number of a geom; MuJoCo's own label of what is none


@dataclasses.dataclass(frozen=True)
class Camera:
    """Which images to record.

    Attributes:
      name: of the scene's camera, or `random`. size: height and width, pixels.
      buffers: whether depth and segmentation are kept, too.
    """

    name: str
    size: int = 128
    buffers: bool = True

    def __post_init__(self) -> None:
        if not 8 <= self.size <= 2048:
            raise InputError(f"--size is 8 to 2048 pixels; got {self.size}")


def check_camera(scene: Scene, camera: Camera) -> None:
    """Raises `UnknownNameError` if the scene has no such camera."""
    known = [scene.model.camera(i).name for i in range(scene.model.ncam)]
    if camera.name not in (*known, RANDOM):
        raise UnknownNameError("camera", camera.name, [*known, RANDOM])


def random_orbit(seed: int) -> Orbit:
    """A camera that sees a table top of the tasks, from the side opposite the arm or beside it."""
    rng = stream(seed, _DRAW)
    x, y, z = rng.uniform([0.45, -0.08, 0.0], [0.6, 0.08, 0.1])
    return Orbit(
        (float(x), float(y), float(z)),
        float(rng.uniform(0.9, 1.3)),
        float(rng.uniform(60.0, 300.0)),
        float(rng.uniform(-60.0, -20.0)),
    )


def with_frames(episode: Episode, scene: Scene, camera: Camera) -> Episode:
    """The episode with images, the camera's pose and intrinsics, and the geoms that are seen."""
    renderer = make_renderer("mujoco", scene)
    try:
        arrays = _images(renderer, episode, scene, camera)
    finally:
        renderer.close()
    arrays |= _viewpoints(episode, scene, camera)
    arrays |= visible.poses(scene.model, episode.arrays["qpos"])
    arrays["descriptor/geoms"] = visible.rows(scene.model)
    arrays["descriptor/lights"] = visible.lights(scene.model)
    columns = {
        **episode.columns,
        "descriptor/geoms": visible.COLUMNS,
        "descriptor/lights": visible.LIGHT_COLUMNS,
    }
    return dataclasses.replace(episode, arrays={**episode.arrays, **arrays}, columns=columns)


def _images(
    renderer: Any, episode: Episode, scene: Scene, camera: Camera
) -> dict[str, npt.NDArray[Any]]:
    chosen: Any = camera.name
    if chosen == RANDOM:
        chosen = random_orbit(episode.seed).to_mujoco()
    options = {"camera": chosen, "height": camera.size, "width": camera.size}
    states = [_state(episode, t) for t in range(episode.steps + 1)]

    def every(mode: str) -> npt.NDArray[Any]:
        return np.stack([renderer.render(state, mode=mode, **options) for state in states])

    arrays = {f"frames/{camera.name}": every("rgb")}
    if camera.buffers:
        arrays[f"depth/{camera.name}"] = every("depth")
        arrays[f"segmentation/{camera.name}"] = _geoms_only(every("segmentation"))
    return arrays


def _geoms_only(labels: npt.NDArray[np.int32]) -> npt.NDArray[np.int16]:
    """Numbers of geoms [...], -1 where there is none, of (object, type) [..., 2]."""
    geom = labels[..., 1] == int(mujoco.mjtObj.mjOBJ_GEOM)
    return np.where(geom, labels[..., 0], _BACKGROUND).astype(np.int16)


def _state(episode: Episode, t: int) -> State:
    time, qpos, qvel, act = (
        episode.arrays[name][t : t + 1] for name in ("time", "qpos", "qvel", "act")
    )
    return State(time, qpos, qvel, act)


def _viewpoints(episode: Episode, scene: Scene, camera: Camera) -> dict[str, npt.NDArray[Any]]:
    views = _each_viewpoint(episode, scene, camera)
    return {
        f"cameras/{camera.name}/pos": np.stack([view.pos for view in views]),
        f"cameras/{camera.name}/rot": np.stack([view.rot for view in views]),
        f"descriptor/intrinsics/{camera.name}": views[0].intrinsics(camera.size, camera.size),
    }


def _each_viewpoint(episode: Episode, scene: Scene, camera: Camera) -> list[Viewpoint]:
    model, count = scene.model, episode.steps + 1
    if camera.name == RANDOM:
        return [random_orbit(episode.seed).camera(float(model.vis.global_.fovy))] * count
    data, number = mujoco.MjData(model), model.camera(camera.name).id
    views = []
    for qpos in episode.arrays["qpos"]:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        views.append(read_camera(model, data, number))
    return views
