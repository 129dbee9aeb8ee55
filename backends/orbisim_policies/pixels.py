"""Policies that see images alone: states are read off frames (paper 3.5, the second regime).

StaInf reads each frame of a camera, and its answer is fitted to the frame, as by `orbisim infer`.
The episode itself is C MuJoCo's, and so is what it is worth.
"""

from __future__ import annotations

import concurrent.futures
import functools
import multiprocessing
from collections.abc import Sequence
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
    problem: Problem, policy: Any, seed: int, camera: str, how: str, device: str = "cpu"
) -> Played:
    """One episode of a policy that sees `camera`'s frames, and of the scene what no frame shows.

    Args:
      problem: on the CPU. policy: from observations to actions. seed: of the episode.
      camera: name or number; the first if empty. how, device: see `Sight`.
    """
    scene, starts = problem.trials(1, seed)
    number = numbered(scene, camera)
    sight = Sight(scene, number, problem.timestep, how, device)
    joints = sight.refiner.scalar.qpos
    worlds = TrueWorlds(problem, 1, 1)
    worlds.begin(np.arange(1), starts)
    renderer = make_renderer("mujoco", scene)
    command, act = as_float(starts.command), begun(policy, 1)
    params = problem.unseen(as_float(starts.params))
    control, score = as_float(starts.ctrl), None
    rows, lost = [], False
    bodies = [body.qpos for body in sight.refiner.bodies]
    try:
        for step in range(problem.steps):
            true, speed = worlds.coordinates
            state = State(np.zeros(1), true, speed, np.zeros((1, scene.model.na)))
            size = sight.size
            image = renderer.render(state, camera=number, height=size, width=size)
            qpos, qvel, seen = sight.see(np.asarray(image).reshape(size, size, 3), true[0, joints])
            q, v = as_float(qpos[None]), as_float(qvel[None])
            time = torch.full((1,), step / problem.steps)
            if score is None:
                score = problem.begin(q, v, command)
            else:
                score = problem.count(score, q, v, control)
            with torch.no_grad():
                action = act(problem.observe(Moment(q, v, command, params, score, time)))
            control, command = problem.control(command, action)
            off = [np.linalg.norm(qpos[b : b + 3] - true[0, b : b + 3]) for b in bodies]
            rows.append((off, np.abs(qpos[joints] - true[0, joints]).mean(), seen))
            if lost := bool(worlds.step(action)[0]):
                break
        end, value = worlds.coordinates[0][0], worlds.measure()[0].double().numpy()
    finally:
        renderer.close()
        worlds.close()
    lost |= not np.isfinite(value).all()
    if lost:
        end, value = starts.qpos[0], np.zeros(len(problem.parts))
    offs, turned, seens = zip(*rows, strict=True)
    return Played(end, value, lost, np.array(offs), np.array(turned), np.array(seens))


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
    jobs = [(problem, policy, seed, camera, how, device, kept, label) for seed in seeds]
    if workers == 1:
        played = [_once(*job) for job in track(jobs, "episodes from pixels", len(jobs))]
    else:
        context = multiprocessing.get_context("spawn")  # a fork would copy a GL context
        with concurrent.futures.ProcessPoolExecutor(workers, context, alone) as pool:
            every = pool.map(_once, *zip(*jobs, strict=True))
            played = list(track(every, "episodes from pixels", len(jobs)))
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


def _once(
    problem: Problem,
    policy: Any,
    seed: int,
    camera: str,
    how: str,
    device: str,
    kept: Path | None,
    label: str,
) -> Played:
    """`play`, or what an earlier run has kept of it."""
    if kept is None:
        return play(problem, policy, seed, camera, how, device)
    path = kept / f"{how}_{seed}.npz"
    if path.exists():
        with np.load(path) as file:
            if str(file["label"]) != label:
                raise InputError(
                    f"{path}: is of {str(file['label'])!r}, not of {label!r}; use another folder"
                )
            return Played(*(file[name] for name in Played._fields))
    played = play(problem, policy, seed, camera, how, device)
    part = path.with_name(f"part_{path.name}")  # a run that is ended leaves no half of a file
    np.savez(part, label=np.array(label), **played._asdict())
    part.replace(path)
    return played


_QUANTILES = {"median": 0.5, "p90": 0.9, "worst": 1.0}


def alone() -> None:
    """Of a process beside others: one thread."""
    torch.set_num_threads(1)
