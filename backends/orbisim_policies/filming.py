"""Filming a task's script in C MuJoCo, and reading its frames, on several processes."""

from __future__ import annotations

import concurrent.futures
import dataclasses
import multiprocessing
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from orbisim.errors import InputError
from orbisim.host.progress import track
from orbisim.registry import make_renderer
from orbisim.state import State
from orbisim_policies.demonstrations import director
from orbisim_policies.evaluate import as_float
from orbisim_policies.films import Films
from orbisim_policies.pixels import Sight, alone, numbered
from orbisim_policies.problem import Problem
from orbisim_policies.push import PushProblem
from orbisim_policies.true import TrueWorlds


def film(
    problem: Problem,
    seeds: Sequence[int],
    *,
    camera: str = "side",
    how: str = "stainf",
    workers: int = 1,
    device: str = "cpu",
) -> Films:
    """Films the script's episodes of these seeds, and reads them; those that diverge are left out.

    Args:
      problem: on the CPU. seeds: of the episodes.
      camera, how, device: see `pixels.Sight`. workers: processes.

    Raises:
      InputError: the problem has no script, or no episode is left.
    """
    if not isinstance(problem, PushProblem):
        raise InputError(f"there is no script to film in {problem.name}; use task:push")
    jobs = [(problem, int(seed), camera, how, device) for seed in seeds]
    if workers == 1:
        rows = [_one(*job) for job in track(jobs, "filming", len(jobs))]
    else:
        context = multiprocessing.get_context("spawn")  # a fork would copy a GL context
        with concurrent.futures.ProcessPoolExecutor(workers, context, alone) as pool:
            every = pool.map(_one, *zip(*jobs, strict=True))
            rows = list(track(every, "filming", len(jobs)))
    kept = [(seed, row) for seed, row in zip(seeds, rows, strict=True) if row is not None]
    if not kept:
        raise InputError(f"{problem.name}: all of {len(jobs)} filmed episodes diverged")
    arrays = {name: np.stack([row[name] for _, row in kept]) for name in kept[0][1]}
    params = problem.unseen(as_float(problem.draw([seed for seed, _ in kept]).params))
    notes = {"task": problem.name, "observe": how, "camera": camera, "asked": len(jobs)}
    found = Films(
        np.array([seed for seed, _ in kept]), params=params.double().numpy(), notes=notes, **arrays
    )
    return dataclasses.replace(found, notes={**notes, "off": _off(problem, found)})


def _one(
    problem: PushProblem, seed: int, camera: str, how: str, device: str
) -> dict[str, npt.NDArray[Any]] | None:
    """One film as `Films` has it; None if the episode diverged."""
    scene, starts = problem.trials(1, seed)
    number = numbered(scene, camera)
    sight = Sight(scene, number, problem.timestep, how, device)
    acts, command, size = director(problem, seed), as_float(starts.command), sight.size
    worlds, renderer = TrueWorlds(problem, 1, 1), make_renderer("mujoco", scene)
    rows: dict[str, list[Any]] = {n: [] for n in ("qpos", "qvel", "ctrl", "command", "action")}
    frames = []
    try:
        worlds.begin(np.arange(1), starts)
        for _ in range(problem.steps):
            qpos, qvel = worlds.coordinates
            state = State(np.zeros(1), qpos, qvel, np.zeros((1, scene.model.na)))
            image = renderer.render(state, camera=number, height=size, width=size)
            frames.append(np.asarray(image).reshape(size, size, 3))
            action = torch.as_tensor(acts.action()).float()[None]
            control, after = problem.control(command, action)
            given = (qpos[0], qvel[0], control[0].double().numpy(), command[0].double().numpy())
            for name, value in zip(rows, (*given, action[0].double().numpy()), strict=True):
                rows[name].append(value)
            command = after
            if worlds.step(action)[0]:
                return None
        end, value = worlds.coordinates[0], worlds.measure().double().numpy()
    finally:
        renderer.close()
        worlds.close()
    found = {name: np.stack(values) for name, values in rows.items()}
    found["true_qpos"], found["true_qvel"] = found.pop("qpos"), found.pop("qvel")
    joints, read = sight.refiner.scalar.qpos, sight.read(np.stack(frames))
    read_rows = [
        sight.take(frame, read, t, found["true_qpos"][t, joints]) for t, frame in enumerate(frames)
    ]
    found["qpos"], found["qvel"], found["seen"] = map(np.stack, zip(*read_rows, strict=True))
    found["success"] = np.asarray(next(iter(problem.success(starts, end, value).values()))[0])
    return found


def _off(problem: Problem, films: Films) -> dict[str, dict[str, float]]:
    """How far readings are off: free bodies in mm, scalar joints in rad or m."""
    model = problem.scene.model
    free = np.flatnonzero(model.jnt_type == 0)
    scalar = model.jnt_qposadr[model.jnt_type >= 2]
    gap = films.qpos - films.true_qpos
    places = [np.linalg.norm(gap[..., a : a + 3], axis=-1) for a in model.jnt_qposadr[free]]
    found = {"joints_rad": np.abs(gap[..., scalar]).mean(-1)}
    if places:
        found["bodies_mm"] = 1e3 * np.stack(places)
    quantiles = {"median": 0.5, "p90": 0.9, "worst": 1.0}
    return {
        name: {n: float(np.quantile(values, q)) for n, q in quantiles.items()}
        for name, values in found.items()
    }
