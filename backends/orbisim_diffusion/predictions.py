"""Poses of the geoms of recorded episodes as a backend predicts them from their first states."""

from __future__ import annotations

import concurrent.futures
import dataclasses
import multiprocessing
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbisim.files import npz
from orbisim.files.writing import writing
from orbisim.host.progress import track
from orbisim.registry import make_backend, make_renderer
from orbisim.scene import Scene, visible
from orbisim.state import State
from orbisim.tasks.dataset import EpisodeFile
from orbisim.tasks.frames import RANDOM, random_orbit
from orbisim.tasks.registry import make
from orbisim_diffusion.store import Store

Arrays = dict[str, npt.NDArray[Any]]
_FRAMES = "frames/"
RECORDED = "recorded"
"""In the place of a backend: the states of the file."""


@dataclasses.dataclass(frozen=True)
class StateNoise:
    """Gaussian noise on coordinates, as estimates from images have it; velocities get none.

    Attributes:
      metres: standard deviation of each coordinate of a free body's position, and of sliding
        joints. radians: of each component of its turn, and of hinges.
      every: whether each state gets noise of its own; else the first alone, from which the others
        are predicted. seed: beside each episode's own.
    """

    metres: float
    radians: float
    every: bool = False
    seed: int = 0


def perturbed(
    model: mujoco.MjModel, qpos: npt.NDArray[Any], noise: StateNoise, rng: np.random.Generator
) -> npt.NDArray[Any]:
    """Coordinates [..., nq] with noise; joints stay in their ranges."""
    kinds = mujoco.mjtJoint
    scale = np.full(model.nv, noise.radians)
    for joint in range(model.njnt):
        first, kind = int(model.jnt_dofadr[joint]), int(model.jnt_type[joint])
        if kind in (int(kinds.mjJNT_FREE), int(kinds.mjJNT_SLIDE)):
            scale[first : first + (3 if kind == int(kinds.mjJNT_FREE) else 1)] = noise.metres
    found = np.array(qpos, float)
    for row in found.reshape(-1, model.nq):
        mujoco.mj_integratePos(model, row, scale * rng.standard_normal(model.nv), 1.0)
    for joint in np.flatnonzero(model.jnt_limited).tolist():
        if int(model.jnt_type[joint]) in (int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE)):
            column = int(model.jnt_qposadr[joint])
            # a recorded joint may be a little beyond its range; noise takes none further
            low = np.minimum(model.jnt_range[joint, 0], qpos[..., column])
            high = np.maximum(model.jnt_range[joint, 1], qpos[..., column])
            found[..., column] = np.clip(found[..., column], low, high)
    return found


def predicted_episode(
    path: Path,
    index: int,
    backend: str = "learned",
    seen: bool = False,
    noise: StateNoise | None = None,
) -> Arrays:
    """`geoms/pos` and `geoms/quat` [T+1, G, ...] of one episode, free-running.

    The episode's own scene is drawn again from its task and seed; the backend gets its first state
    and its controls.

    Args:
      path, index: the episode. backend: what predicts, or `RECORDED`.
      seen: whether MuJoCo's images of the predicted states are wanted, too: `frames` [T+1, H, W, 3]
        of the episode's camera. noise: on the states, drawn from the episode's seed and its own.
    """
    torch.set_num_threads(1)
    with EpisodeFile(path) as file:
        known = file.attributes(index)
        arrays = file.episode(index, ["time", "qpos", "qvel", "act", "ctrl"])
        scene = make(file.task, **file.config).scene(known["subtask"], known["seed"])
        camera = next(n for n in file.names(index) if n.startswith(_FRAMES)) if seen else ""
        size = len(file.episode(index, [camera])[camera][0]) if seen else 0
        camera = camera.removeprefix(_FRAMES)
    rng = np.random.default_rng([known["seed"], 45, noise.seed if noise else 0])
    qpos = arrays["qpos"]
    if noise is not None and not noise.every:
        arrays["qpos"] = np.concatenate([perturbed(scene.model, qpos[:1], noise, rng), qpos[1:]])
    if backend != RECORDED:
        qpos = _rollout(scene, arrays, backend)
    if noise is not None and noise.every:
        qpos = perturbed(scene.model, qpos, noise, rng)
    found: Arrays = dict(visible.poses(scene.model, qpos))
    if seen:
        found["frames"] = _images(scene, arrays["time"], qpos, known["seed"], camera, size)
    return found


def _rollout(scene: Scene, arrays: Arrays, backend: str) -> npt.NDArray[Any]:
    """Coordinates [T+1, nq] of a free run from the first state under the recorded controls."""
    # One world in each of many processes, which on a GPU would each compile the step.
    options: dict[str, Any] = {"native": False, "device": "cpu"} if backend == "learned" else {}
    engine = make_backend(backend, scene, **options)
    start = State(*(arrays[name][:1] for name in ("time", "qpos", "qvel", "act")))  # type: ignore[arg-type]
    nstep = round(float(arrays["time"][1] - arrays["time"][0]) / engine.timestep)
    run = engine.rollout(start, arrays["ctrl"][None], nstep=nstep, sensors=False)
    qpos = np.concatenate([arrays["qpos"][:1], np.asarray(run.qpos)[0]])
    lost = ~np.isfinite(qpos).all(1)
    if lost.any():  # a rollout that diverged stays where it was last
        qpos[lost] = qpos[np.argmax(lost) - 1]
    return qpos


def _images(
    scene: Scene,
    time: npt.NDArray[np.float64],
    qpos: npt.NDArray[np.float64],
    seed: int,
    camera: str,
    size: int,
) -> npt.NDArray[np.uint8]:
    chosen: Any = random_orbit(seed).to_mujoco() if camera == RANDOM else camera
    renderer = make_renderer("mujoco", scene)
    blank = np.zeros((1, scene.model.nv)), np.zeros((1, scene.model.na))
    try:
        return np.stack(
            [
                renderer.render(
                    State(time[t : t + 1], qpos[t : t + 1], *blank),
                    camera=chosen,
                    height=size,
                    width=size,
                )
                for t in range(len(qpos))
            ]
        )
    finally:
        renderer.close()


def predict(
    path: Path,
    episodes: Sequence[int],
    workers: int = 1,
    backend: str = "learned",
    seen: bool = False,
    noise: StateNoise | None = None,
) -> list[Arrays]:
    """`predicted_episode` of some episodes of a file.

    Args:
      path: the file. episodes: which. workers: processes. backend, seen, noise: see
        `predicted_episode`.
    """
    made = _all(path, episodes, workers, backend, seen, noise)
    return list(track(made, "predicting", len(episodes)))


def with_predictions(store: Store, found: Sequence[Arrays]) -> Store:
    """A store with predicted poses, and images where there are some, in the place of the true ones.

    Args:
      store: of one file. found: of its first episodes.
    """
    pos, quat, frames = store.pos.clone(), store.quat.clone(), store.frames.clone()
    for index, arrays in enumerate(found):
        first, length = int(store.first[index]), int(store.length[index])
        for into, name in ((pos, "geoms/pos"), (quat, "geoms/quat")):
            values: Tensor = torch.as_tensor(arrays[name]).to(store.device)
            into[first : first + length, : values.shape[1]] = values
        if "frames" in arrays:
            frames[first : first + length] = torch.as_tensor(arrays["frames"]).to(store.device)
    return dataclasses.replace(store.with_poses(pos, quat), frames=frames)


def save_predictions(path: Path, found: Sequence[Arrays]) -> None:
    """Writes predictions to an .npz file."""
    named = {f"{i}/{n}": array for i, arrays in enumerate(found) for n, array in arrays.items()}
    with writing(path, announce=False) as part, part.open("wb") as file:
        np.savez(file, **named)  # type: ignore[arg-type]


def read_predictions(path: Path) -> list[Arrays]:
    """Reads what `save_predictions` wrote."""
    found: dict[int, Arrays] = {}
    with npz.opened(path) as file:
        for key in file:
            number, name = key.split("/", 1)
            found.setdefault(int(number), {})[name] = file[key]
    return [found[number] for number in sorted(found)]


def _all(
    path: Path,
    episodes: Sequence[int],
    workers: int,
    backend: str,
    seen: bool,
    noise: StateNoise | None,
) -> Any:
    if workers == 1:
        yield from (predicted_episode(path, index, backend, seen, noise) for index in episodes)
        return
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # for the processes that are started now
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(workers, mp_context=context) as pool:
        count = len(episodes)
        yield from pool.map(
            predicted_episode,
            [path] * count,
            episodes,
            [backend] * count,
            [seen] * count,
            [noise] * count,
            chunksize=2,
        )
