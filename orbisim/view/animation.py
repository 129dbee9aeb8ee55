"""Trajectories as meshcat animations."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError
from orbisim.scene import Scene
from orbisim.trajectory import Trajectory
from orbisim.view.drawing import Drawing
from orbisim.view.three import Json, floats

Array = npt.NDArray[np.float64]

_LOOP = 2201
"""three.js's LoopRepeat."""

_MOST_FRAMES = 10_000_000
"""Hours at any rate; the page for them would have gigabytes."""


@dataclasses.dataclass(frozen=True, eq=False)
class Frames:
    """The part of one world's trajectory that is shown.

    Attributes:
      time: [k], s since the trajectory's start, strictly increasing from 0.
      qpos: [k, nq], finite.
      memory: `mocap_pos` and `mocap_quat` of the world, where the trajectory has them.
      stopped_at: time of the first state that is not finite, s since the start; None if all are.
    """

    time: Array
    qpos: Array
    memory: Mapping[str, Array]
    stopped_at: float | None = None

    @property
    def duration(self) -> float:
        """Time of the last frame, s."""
        return float(self.time[-1])


def frames_of(
    scene: Scene, trajectory: Trajectory, *, world: int, fps: float, what: str = "trajectory"
) -> Frames:
    """The states of one world nearest to every 1/fps s, up to where they stop being finite.

    Args:
      what: what the trajectory is called in errors.

    Raises:
      InputError: the trajectory does not fit the scene, has no such world, its first state is
        not finite or its time does not increase.
    """
    if not fps > 0:
        raise InputError(f"fps must be above 0; got {fps}")
    _check_fits(scene, trajectory, world, what)
    time = _host(trajectory.with_initial("time"))[world]
    qpos = _host(trajectory.with_initial("qpos"))[world]
    usable = np.isfinite(qpos).all(axis=1) & np.isfinite(time)
    if not usable[0]:
        raise InputError(f"the {what}'s first state is not finite; there is nothing to show")
    count = len(usable) if usable.all() else int(np.argmin(usable))
    elapsed = time[:count] - time[0]
    if (np.diff(elapsed) <= 0).any():
        step = int(np.argmax(np.diff(elapsed) <= 0))
        raise InputError(f"the {what}'s time does not increase from step {step - 1} to {step}")
    if elapsed[-1] * fps > _MOST_FRAMES:
        raise InputError(
            f"the {what} lasts {elapsed[-1]:.4g} s, which is {elapsed[-1] * fps:.3g} frames at "
            f"{fps:g} for each second; at most {_MOST_FRAMES} are shown"
        )
    chosen = nearest_to_grid(elapsed, fps)
    stopped_at = None if count == len(usable) else _stop(time, count)
    return Frames(elapsed[chosen], qpos[chosen], _mocap(trajectory, world), stopped_at)


def nearest_to_grid(elapsed: Array, fps: float) -> npt.NDArray[np.intp]:
    """Numbers of the samples nearest to 0, 1/fps, 2/fps ...; the last is always among them.

    Args:
      elapsed: [n], increasing from 0.
    """
    grid = np.arange(int(np.floor(elapsed[-1] * fps + 1e-9)) + 1) / fps
    after = np.clip(np.searchsorted(elapsed, grid), 0, len(elapsed) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.where(grid - elapsed[before] < elapsed[after] - grid, before, after)
    return np.unique(np.append(nearer, len(elapsed) - 1))


def animate(copies: list[tuple[Drawing, Frames]]) -> Iterator[Json]:
    """Commands that animate copies together, each from its own start.

    All tracks last as long as the longest copy, so that they stay together when repeated. Every
    drawing is left at its first frame.
    """
    duration = max(frames.duration for _, frames in copies)
    clips: list[Json] = []
    for drawing, frames in copies:
        time, held = frames.time, len(frames.time)
        if frames.duration < duration:
            time = np.append(time, duration)
        poses, shapes = _record(drawing, frames)
        for body, pose in poses.items():
            track = np.concatenate([pose, np.repeat(pose[-1:], len(time) - held, axis=0)])
            clips += _clip(drawing.bodies[body], time, track)
        for path, sequence in shapes.items():
            if any(len(vertices) for vertices in sequence):
                yield _vertex_track(path, frames.time, sequence)
    if not clips:  # something must run the clock of a scene where only flexes move
        clips = [_idle(copies[0][0].look.root, duration)]
    yield {
        "type": "set_animation",
        "path": "",
        "animations": clips,
        "options": {"play": True, "loopMode": _LOOP, "repetitions": float("inf")},
    }


def _record(
    drawing: Drawing, frames: Frames
) -> tuple[dict[int, Array], dict[str, list[npt.NDArray[np.float32]]]]:
    """Poses [k, 7] (position, quaternion w x y z) of moving bodies, and deforming vertices."""
    poses = {body: np.empty((len(frames.time), 7)) for body in drawing.moving}
    shapes: dict[str, list[npt.NDArray[np.float32]]] = {d.path: [] for d in drawing.deforming}
    data = drawing.kinematics.data
    for k, qpos in enumerate(frames.qpos):
        drawing.place(qpos, frames.memory)
        for body, pose in poses.items():
            pose[k, :3], pose[k, 3:] = data.xpos[body], data.xquat[body]
        for deforming in drawing.deforming:
            shapes[deforming.path].append(deforming.vertices(data))
    drawing.place(frames.qpos[0], frames.memory)
    return poses, shapes


def _clip(path: str, time: Array, pose: Array) -> Iterator[Json]:
    """The clip of one body; nothing if it never moves.

    three.js's quaternions are x, y, z, w.
    """
    single = pose.astype(np.float32)
    if (single == single[0]).all():
        return
    tracks = [
        _track(".position", "vector3", time, single[:, :3]),
        _track(".quaternion", "quaternion", time, single[:, [4, 5, 6, 3]]),
    ]
    yield {"path": path, "clip": {"name": "default", "fps": 1.0, "tracks": tracks}}


def _track(name: str, kind: str, time: Array, values: npt.NDArray[np.float32]) -> Json:
    """Keys of a property; those between two equal ones are left out."""
    changes = (values[1:] != values[:-1]).any(axis=1)
    kept = np.concatenate([[True], changes[:-1] | changes[1:], [True]])
    return {
        "name": name,
        "type": kind,
        "times": floats(time[kept]),
        "values": floats(values[kept]),
    }


def _idle(path: str, duration: float) -> Json:
    ends = np.array([0.0, duration])
    track = _track(".position", "vector3", ends, np.zeros((2, 3), np.float32))
    return {"path": path, "clip": {"name": "default", "fps": 1.0, "tracks": [track]}}


def _vertex_track(path: str, time: Array, sequence: list[npt.NDArray[np.float32]]) -> Json:
    """Vertices over time; frames with fewer are filled up with copies of one of theirs."""
    most = max(len(vertices) for vertices in sequence)
    full = np.zeros((len(sequence), most, 3), np.float32)
    for filled, vertices in zip(full, sequence, strict=True):
        filled[: len(vertices)] = vertices
        filled[len(vertices) :] = vertices[0] if len(vertices) else 0.0
    return {
        "type": "vertex_track",
        "path": path,
        "times": floats(time),
        "positions": floats(full),
        "interpolate": len({len(vertices) for vertices in sequence}) == 1,
    }


def _check_fits(scene: Scene, trajectory: Trajectory, world: int, what: str) -> None:
    model = scene.model
    for name, size, unit in (("qpos", model.nq, "nq"), ("qvel", model.nv, "nv")):
        got = int(getattr(trajectory, name).shape[-1])
        if got != size:
            raise InputError(
                f"the {what} does not fit scene {scene.name!r}: its {name} has {got} columns and "
                f"the scene's {unit} is {size}; give the scene that it was recorded in"
            )
    if not 0 <= world < trajectory.nworld:
        raise InputError(
            f"the {what} has {trajectory.nworld} world{'s' * (trajectory.nworld != 1)}, numbered "
            f"from 0; got world {world}"
        )


def _stop(time: Array, count: int) -> float:
    """When the first state that is not finite was due."""
    due = time[count] - time[0]
    return float(due if np.isfinite(due) else time[count - 1] - time[0])


def _mocap(trajectory: Trajectory, world: int) -> dict[str, Array]:
    memory = trajectory.initial.memory
    return {n: _host(memory[n])[world] for n in ("mocap_pos", "mocap_quat") if n in memory}


def _host(array: Any) -> Array:
    host = array.detach().cpu().numpy() if hasattr(array, "detach") else array
    return np.asarray(host, np.float64)
