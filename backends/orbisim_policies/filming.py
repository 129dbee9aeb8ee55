"""Filming a task's script in C MuJoCo, and reading its frames, on several processes.

The script does not look at frames, so that episodes are stepped first, many at once; frames are
drawn and read afterwards, an episode at a time. On a GPU few processes do that: what draws there
takes turns, and many contexts of graphics and of computing wait for each other longer than they
work.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import dataclasses
import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
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
from orbisim_policies.pixels import Sight, alone, keep, kept_of, numbered, processes
from orbisim_policies.problem import Problem
from orbisim_policies.push import PushProblem
from orbisim_policies.true import TrueWorlds

Film = dict[str, npt.NDArray[Any]]
"""One film as `Films` has it; before its frames have been read, without what is read off them."""
_AT_ONCE = 64
"""Worlds that are stepped before their frames are drawn: few, so that films are soon there."""


def film(
    problem: Problem,
    seeds: Sequence[int],
    *,
    camera: str = "side",
    how: str = "stainf",
    workers: int = 1,
    device: str = "cpu",
    kept: Path | None = None,
    limit: float | None = None,
) -> Films:
    """Films the script's episodes of these seeds, and reads them; those that diverge are left out.

    Args:
      problem: on the CPU. seeds: of the episodes.
      camera, how, device: see `pixels.Sight`. workers: processes; on a GPU see
        `pixels.processes`.
      kept: folder for each film once it has been read; those that it has are not filmed again.
      limit: s, after which no film is begun; those that are ready are what is given back, the
        first one in any case. All if None.

    Raises:
      InputError: the problem has no script, no episode is left, or `kept` holds films of another
        task, camera or reading.
    """
    if not isinstance(problem, PushProblem):
        raise InputError(f"there is no script to film in {problem.name}; use task:push")
    end = None if limit is None else time.monotonic() + limit
    label = f"{problem.name} {problem.steps} {how} {camera}"
    rows: dict[int, Film] = {}
    for seed in seeds if kept is not None else ():
        if found := kept_of(kept, str(seed), label):
            rows[seed] = found
    rest = [seed for seed in seeds if seed not in rows]
    jobs = (
        (problem, seed, row, camera, how, device, kept, label)
        for seed, row in _acted(problem, rest, workers)
    )
    rows |= dict(_each(jobs, len(rest), processes(workers, device), end))
    taken = [seed for seed in seeds if seed in rows]
    if not taken:
        raise InputError(f"{problem.name}: all of {len(rest)} filmed episodes diverged")
    arrays = {name: np.stack([rows[seed][name] for seed in taken]) for name in rows[taken[0]]}
    params = problem.unseen(as_float(problem.draw(taken).params))
    notes = {"task": problem.name, "observe": how, "camera": camera, "asked": len(seeds)}
    films = Films(np.array(taken), params=params.double().numpy(), notes=notes, **arrays)
    return dataclasses.replace(films, notes={**notes, "off": _off(problem, films)})


def _each(
    jobs: Iterator[tuple[Any, ...]], count: int, number: int, end: float | None
) -> Iterator[tuple[int, Film]]:
    """Seed and film of each job that is ready by `end`, but of one in any case."""

    def late() -> bool:
        return end is not None and time.monotonic() > end

    if number == 1:
        for done, job in enumerate(track(jobs, "filming", count)):
            if done and late():
                return
            yield _read(*job)
        return
    context = multiprocessing.get_context("spawn")  # a fork would copy a GL context
    with concurrent.futures.ProcessPoolExecutor(number, context, alone) as pool:
        waiting: list[concurrent.futures.Future[tuple[int, Film]]] = []
        for job in jobs:
            if waiting and late():
                break
            waiting.append(pool.submit(_read, *job))
        left = None if end is None else max(end - time.monotonic(), 0.0)
        every = concurrent.futures.as_completed(waiting, left)
        with contextlib.suppress(TimeoutError):
            for _ in track(every, "filming", len(waiting)):
                pass
        for future in waiting[1:]:
            future.cancel()  # of what is running nothing is lost
        for future in waiting:
            if not future.cancelled():
                yield future.result()


def _acted(problem: PushProblem, seeds: Sequence[int], threads: int) -> Iterator[tuple[int, Film]]:
    """Seed and true states of each episode that does not diverge, in C MuJoCo."""
    for first in range(0, len(seeds), _AT_ONCE):
        part = seeds[first : first + _AT_ONCE]
        starts, directors = problem.draw(part), [director(problem, seed) for seed in part]
        rows: dict[str, list[npt.NDArray[Any]]]
        rows = {n: [] for n in ("true_qpos", "true_qvel", "command", "action", "ctrl")}
        going = np.arange(len(part))
        with contextlib.closing(TrueWorlds(problem, len(part), threads)) as worlds:
            worlds.begin(going, starts)
            for _ in range(problem.steps):
                action = torch.as_tensor(np.array([one.action() for one in directors])).float()
                before = (*worlds.coordinates, worlds.command.double().numpy())
                going = going[~worlds.step(action, going)[going]]
                now = (*before, action.double().numpy(), worlds.control)
                for values, value in zip(rows.values(), now, strict=True):
                    values.append(value)
            end, value = worlds.coordinates[0], worlds.measure().double().numpy()
        success = next(iter(problem.success(starts, end, value).values()))
        films = {name: np.stack(values, 1) for name, values in rows.items()}
        for world in map(int, going):
            film = {name: values[world] for name, values in films.items()}
            yield part[world], {**film, "success": np.asarray(success[world])}


def _read(
    problem: PushProblem,
    seed: int,
    acted: Film,
    camera: str,
    how: str,
    device: str,
    kept: Path | None,
    label: str,
) -> tuple[int, Film]:
    """The seed, and the film of an episode whose true states are known: drawn and read."""
    scene, _ = problem.trials(1, seed)
    number, true = numbered(scene, camera), acted["true_qpos"]
    sight = Sight(scene, number, problem.timestep, how, device)
    times, size = np.zeros(len(true)), sight.size
    states = State(times, true, acted["true_qvel"], np.zeros((len(true), scene.model.na)))
    with contextlib.closing(make_renderer("mujoco", scene)) as renderer:
        render: Callable[..., Any] = renderer.render
        drawn = [
            render(states, world=t, camera=number, height=size, width=size)
            for t in range(len(true))
        ]
    frames = np.stack(drawn).reshape(len(true), size, size, 3)
    read, joints = sight.read(frames), sight.refiner.scalar.qpos
    taken = [sight.take(frame, read, t, true[t, joints]) for t, frame in enumerate(frames)]
    qpos, qvel, seen = map(np.stack, zip(*taken, strict=True))
    found = {**acted, "qpos": qpos, "qvel": qvel, "seen": seen}
    if kept is not None:
        keep(kept, str(seed), label, found)
    return seed, found


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
