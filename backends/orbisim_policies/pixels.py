"""Policies that see images alone: states are read off frames (paper 3.5, the second regime).

StaInf reads each frame of a camera, and its answer is fitted to the frame, as by `orbisim infer`.
The episode itself is C MuJoCo's, and so is what it is worth.
"""

from __future__ import annotations

import concurrent.futures
import functools
import multiprocessing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from orbisim_diffusion import zoo
from orbisim_diffusion.estimate import load_inference, read_frames
from orbisim_diffusion.likeness import like_turns
from orbisim_diffusion.refine import Frame, Refiner
from orbisim_diffusion.tracking import (
    Reading,
    expected,
    gone,
    nearest_turns,
    places_of,
    reading,
)

from orbisim.cameras import camera_number
from orbisim.errors import InputError
from orbisim.host.progress import track
from orbisim.registry import make_renderer
from orbisim.scene import Scene, visible
from orbisim.state import State
from orbisim_policies.evaluate import as_float, begun, joined, summary
from orbisim_policies.problem import Floats, Moment, Problem
from orbisim_policies.true import TrueWorlds

_ONE = np.ones(1, bool)


class Played(NamedTuple):
    """An episode of a policy that saw images alone.

    Attributes:
      qpos: [nq] at the end. value: [parts], `Problem.measure`. lost: whether it diverged.
      off: [steps, bodies] m, how far the free bodies were from where they were seen.
      turned: [steps] rad, the mean error of the scalar joints.
      seen: [steps, bodies] whether the fit said that it saw them.
    """

    qpos: Floats
    value: Floats
    lost: bool
    off: Floats
    turned: Floats
    seen: npt.NDArray[np.bool_]


class Sight:
    """States of one episode, read off its frames one after the other.

    Args:
      scene: with the objects that there are. camera: its number. dt: s between frames.
      how: `stainf`, what the network says; `infer`, that fitted to the frames; `objects`, with
        scalar joints that are measured, so that objects alone are fitted.
      device: where the network computes; the fit is the CPU's.

    Raises:
      UnsupportedSceneError: no checkpoint with StaInf was trained on such scenes.
    """

    def __init__(
        self, scene: Scene, camera: int, dt: float, how: str = "infer", device: str = "cpu"
    ) -> None:
        folder = zoo.find(scene, visible.rows(scene.model))
        self.point, self._network = _network(str(folder), device)
        self.size = int(self.point.config.size)
        self.refiner = Refiner(scene, camera, self.size)
        self._model, self._dt, self._how = scene.model, dt, how
        self._like = {
            body.qpos: like_turns(body.half) if body.box else np.eye(3)[None]
            for body in self.refiner.bodies
        }
        self._found: list[Frame] = []
        self._states: list[Floats] = []

    def see(
        self, frame: npt.NDArray[np.uint8], measured: Floats
    ) -> tuple[Floats, Floats, npt.NDArray[np.bool_]]:
        """qpos [nq], qvel [nv] by the last two frames, and which free bodies are seen.

        Args:
          frame: [size, size, 3], the next one. measured: scalar joints, for `objects` alone.
        """
        return self.take(frame, self.read(frame[None]), 0, measured)

    def read(self, frames: npt.NDArray[np.uint8]) -> Reading:
        """What the network says of frames [T, size, size, 3]."""
        return reading(read_frames(frames, self.point, self._network), self._joints)

    def take(
        self, frame: npt.NDArray[np.uint8], read: Reading, t: int, measured: Floats
    ) -> tuple[Floats, Floats, npt.NDArray[np.bool_]]:
        """As `see`, with what the network says of the frame: number `t` of `read`."""
        refiner, last, found = self.refiner, self._states, self._found
        columns, known = refiner.scalar.qpos, measured if self._how == "objects" else None
        places = [places_of(read, t, body) for body in refiner.bodies]
        if self._how == "stainf":
            qpos = np.array(refiner.rest)
            qpos[columns] = read.joints[t]
            for body, place in zip(refiner.bodies, places, strict=True):
                qpos[body.qpos : body.qpos + 3] = place[0][:3]
                turn = slice(body.qpos + 3, body.qpos + 7)
                # of turns that look alike the one nearest to the frame before
                before = last[-1][turn] if last else None
                like = self._like[body.qpos]
                qpos[turn] = nearest_turns(place[0][None, 3:], _ONE, like, before)[0]
            seen = np.ones(len(refiner.bodies), bool)
        else:
            reads = read.joints[t]
            if not found:
                if known is None:
                    one = refiner.first(frame, reads, places, reads)
                else:
                    one = refiner.first(frame, known, places)
            else:
                joints = expected(found, columns)
                ahead = [gone(found, i) for i in range(len(refiner.bodies))]
                one = refiner.following(frame, joints, places, found[-1], known, ahead, reads)
            self._found = [*found[-1:], one]
            qpos = np.array(one.qpos)
            if known is not None:
                qpos[columns] = known
            seen = np.array([pose.seen for pose in one.objects])
        qvel = np.zeros(self._model.nv)
        if last:
            mujoco.mj_differentiatePos(self._model, qvel, self._dt, last[-1], qpos)
        self._states = [*last[-1:], qpos]
        return qpos, qvel, seen

    @property
    def _joints(self) -> int:
        return len(self.refiner.scalar.qpos)


@functools.cache
def _network(folder: str, device: str) -> tuple[Any, Any]:
    """Read once in a process."""
    point, model = load_inference(folder)
    point.autoencoder.to(device)
    return point, model.to(device)


def numbered(scene: Scene, camera: str) -> int:
    """The camera of this name or number; the first if empty."""
    return camera_number(scene.model, int(camera) if camera.isdigit() else camera or 0)


def play(
    problem: Problem,
    policy: Any,
    seeds: Sequence[int],
    camera: str,
    how: str,
    device: str = "cpu",
) -> list[Played]:
    """Episodes of a policy that sees `camera`'s frames, and of the scene what no frame shows.

    They are played in lockstep: the network reads the frames of all of them at once.

    Args:
      problem: on the CPU. policy: from observations to actions. seeds: of the episodes.
      camera: name or number; the first if empty. how, device: see `Sight`.
    """
    count = len(seeds)
    scenes, drawn = zip(*(problem.trials(1, seed) for seed in seeds), strict=True)
    number, starts = numbered(scenes[0], camera), joined(drawn)
    sights = [Sight(scene, number, problem.timestep, how, device) for scene in scenes]
    sight, size = sights[0], sights[0].size
    joints, bodies = sight.refiner.scalar.qpos, [body.qpos for body in sight.refiner.bodies]
    worlds = TrueWorlds(problem, count, 1)
    worlds.begin(np.arange(count), starts)
    renderers = [make_renderer("mujoco", scene) for scene in scenes]
    command, act = as_float(starts.command), begun(policy, count)
    params = problem.unseen(as_float(starts.params))
    control, score, going = as_float(starts.ctrl), None, np.arange(count)
    qpos, qvel = np.array(starts.qpos), np.array(starts.qvel)
    rows: list[list[Any]] = [[] for _ in seeds]
    try:
        for step in range(problem.steps):
            true, speed = worlds.coordinates
            state = State(np.zeros(count), true, speed, np.zeros((count, scenes[0].model.na)))
            images = [
                renderers[i].render(state, world=i, camera=number, height=size, width=size)
                for i in map(int, going)
            ]
            frames = np.stack(images).reshape(len(going), size, size, 3)
            read = sight.read(frames)
            for row, i in enumerate(map(int, going)):
                qpos[i], qvel[i], seen = sights[i].take(frames[row], read, row, true[i, joints])
                far = [np.linalg.norm(qpos[i, b : b + 3] - true[i, b : b + 3]) for b in bodies]
                rows[i].append((far, np.abs(qpos[i, joints] - true[i, joints]).mean(), seen))
            q, v = as_float(qpos), as_float(qvel)
            if score is None:
                score = problem.begin(q, v, command)
            else:
                score = problem.count(score, q, v, control)
            time = torch.full((count,), step / problem.steps)
            with torch.no_grad():
                action = act(problem.observe(Moment(q, v, command, params, score, time)))
            control, command = problem.control(command, action)
            going = going[~worlds.step(action, going)[going]]
            if not len(going):
                break
        end, value = worlds.coordinates[0], worlds.measure().double().numpy()
    finally:
        for renderer in renderers:
            renderer.close()
        worlds.close()
    well = going[np.isfinite(value[going]).all(axis=1)]
    lost = ~np.isin(np.arange(count), well)
    end[lost], value[lost] = starts.qpos[lost], 0.0
    played = []
    for i in range(count):
        off, turned, seen = (np.array(values) for values in zip(*rows[i], strict=True))
        played.append(Played(end[i], value[i], bool(lost[i]), off, turned, seen))
    return played


def evaluate_pixels(
    problem: Problem,
    policy: Any,
    seeds: Sequence[int],
    *,
    camera: str = "side",
    how: str = "infer",
    workers: int = 1,
    device: str = "cpu",
    kept: Path | None = None,
    label: str = "",
) -> dict[str, Any]:
    """Success of a policy that sees images alone, over one episode for each seed.

    Args:
      problem: on the CPU. policy: from observations to actions. seeds: of the episodes.
      camera: name or number. how, device: see `Sight`. workers: processes.
      kept: folder for each episode once it has been played; those that it has are not played again.
      label: of the policy, which the folder's episodes must have.

    Raises:
      InputError: the folder has episodes of another policy, task or camera.
    """
    label = f"{label} {problem.name} {how} {camera}".strip()
    number = processes(workers, device)
    groups = _groups(seeds, number, how, device)
    jobs = [(problem, policy, group, camera, how, device, kept, label) for group in groups]
    if number == 1:
        every = [_once(*job) for job in track(jobs, "episodes from pixels", len(jobs))]
    else:
        context = multiprocessing.get_context("spawn")  # a fork would copy a GL context
        with concurrent.futures.ProcessPoolExecutor(number, context, alone) as pool:
            asked = pool.map(_once, *zip(*jobs, strict=True))
            every = list(track(asked, "episodes from pixels", len(jobs)))
    played = [one for group in every for one in group]
    starts = joined([problem.trials(1, seed)[1] for seed in seeds])
    qpos, value = (np.stack([getattr(one, n) for one in played]) for n in ("qpos", "value"))
    found = summary(problem, starts, qpos, value)
    off = np.concatenate([one.off.reshape(-1) for one in played])
    seen = np.concatenate([one.seen.reshape(-1) for one in played])
    turned = np.concatenate([one.turned for one in played])
    found["states"] = {
        "bodies_mm": {n: 1e3 * float(np.quantile(off, q)) for n, q in _QUANTILES.items()},
        "joints_rad": {n: float(np.quantile(turned, q)) for n, q in _QUANTILES.items()},
        "seen": float(seen.mean()),
    }
    return found | {"diverged": sum(bool(one.lost) for one in played)}


def processes(workers: int, device: str) -> int:
    """How many processes draw and read frames: on a GPU a few at most.

    One process alone draws more there than many that take turns (docs/benchmarks.md: 1,313 to
    1,435 images/s by one, 640 by 14 together with their physics); a few hide what is computed on
    the CPU between two frames.
    """
    return workers if torch.device(device).type == "cpu" else min(workers, _ON_A_GPU)


_ON_A_GPU = 4
"""Processes: see `processes`."""
_TOGETHER = 32
"""Episodes in lockstep, each with an OpenGL context of its own."""


def _groups(seeds: Sequence[int], number: int, how: str, device: str) -> list[Sequence[int]]:
    """Which episodes are played in lockstep: on a GPU, whose time goes with calls and not with
    images, as many as there are for a process; one where each frame is fitted or read on the
    CPU, which gains nothing by waiting for others."""
    size = 1
    if how == "stainf" and torch.device(device).type != "cpu":
        size = max(1, min(_TOGETHER, -(-len(seeds) // number)))
    return [seeds[i : i + size] for i in range(0, len(seeds), size)]


def _once(
    problem: Problem,
    policy: Any,
    seeds: Sequence[int],
    camera: str,
    how: str,
    device: str,
    kept: Path | None,
    label: str,
) -> list[Played]:
    """`play`, or what an earlier run has kept of it."""
    found = {}
    for seed in seeds if kept is not None else ():
        if arrays := kept_of(kept, f"{how}_{seed}", label):
            found[seed] = Played(**arrays)
    rest = [seed for seed in seeds if seed not in found]
    if rest:
        fresh = play(problem, policy, rest, camera, how, device)
        found |= dict(zip(rest, fresh, strict=True))
    if kept is not None:
        for seed in rest:
            keep(kept, f"{how}_{seed}", label, found[seed]._asdict())
    return [found[seed] for seed in seeds]


def keep(folder: Path, name: str, label: str, arrays: Mapping[str, Any]) -> None:
    """Writes arrays to a file of this name; a run that is ended leaves no half of one."""
    part = folder / f"part_{name}.npz"
    np.savez(part, label=np.array(label), **arrays)
    part.replace(folder / f"{name}.npz")


def kept_of(folder: Path | None, name: str, label: str) -> dict[str, Any] | None:
    """What `keep` has written, without the label; None if there is nothing.

    Raises:
      InputError: it has another label.
    """
    if folder is None or not (path := folder / f"{name}.npz").exists():
        return None
    with np.load(path) as file:
        if str(file["label"]) != label:
            raise InputError(
                f"{path}: is of {str(file['label'])!r}, not of {label!r}; use another folder"
            )
        return {key: file[key] for key in file.files if key != "label"}


_QUANTILES = {"median": 0.5, "p90": 0.9, "worst": 1.0}


def alone() -> None:
    """Of a process beside others: one thread."""
    torch.set_num_threads(1)
