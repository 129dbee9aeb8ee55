"""How far apart two backends' cloths are, how deep they are in things, how much they are stretched.

    python tools/drape_metrics.py --a mujoco --b warp --subtask unseen --scenes 4 --episodes 2

Vertex error: distance of each vertex from where backend A has it, after so many control steps of
20 ms. Penetration: depth of a vertex, with the cloth's radius, in an object or the floor. Strain:
change of an edge's length over its length at rest. With --hold N, episodes go on for N control
steps, and so far has each vertex moved in them. All as median, 90 % and greatest over vertices
(edges), episodes and scenes; vertex error at each step, penetration and strain over all steps.
Speed: control steps in a processor second of the rollouts, all threads counted, median over scenes;
each engine has stepped once before, and other processes on the machine hardly matter.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from orbisim import make_backend
from orbisim.tasks.cloth import Probe, edge_strain, vertices
from orbisim.tasks.drape import Drape

Floats = npt.NDArray[np.float64]
AT = (1, 10, 30, 100)
EVERY = 5
"""Control steps between those at which penetration is measured."""


def courses(
    task: Drape, subtask: str, seed: int, episodes: int, backends: Sequence[str], hold: int
) -> tuple[Floats, list[float]]:
    """Vertices of one scene and each backend's control steps in a processor second.

    Vertices are [backends, episodes, T + 1 + hold, V, 3], m.
    """
    setup = task.trials(episodes, seed, subtask)
    model, found, speeds = setup.scene.model, [], []
    steps = AT[-1] + hold
    controls = setup.controls(steps * task.control_timestep, task.control_timestep, seed)
    for name in backends:
        engine = make_backend(name, setup.scene, nworld=episodes)
        nstep = round(task.control_timestep / engine.timestep)
        engine.rollout(setup.initial, controls[:, :1], nstep=nstep)  # some compile first
        began = time.process_time()
        rolled = engine.rollout(setup.initial, controls, nstep=nstep)
        speeds.append(episodes * steps / (time.process_time() - began))
        start = np.asarray(setup.initial.qpos)[:, None]
        qpos = np.asarray(rolled.qpos, np.float64)[:, :steps]
        found.append(vertices(model, np.concatenate([start, qpos], axis=1)))
    return np.stack(found), speeds


def words(values: Floats, unit: float) -> str:
    """Median, 90 % and greatest of some values, in a unit."""
    found = (np.nanmedian(values), np.nanquantile(values, 0.9), np.nanmax(values))
    return " / ".join(f"{v / unit:.3g}" for v in found)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--a", default="mujoco")
    parser.add_argument("--b", default="warp")
    parser.add_argument("--subtask", default="primitives", choices=tuple(Drape.counts))
    parser.add_argument("--scenes", type=int, default=8)
    parser.add_argument("--episodes", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1_000_000)
    parser.add_argument("--hold", type=int, default=0, help="further control steps")
    options = parser.parse_args()
    task, backends = Drape(), (options.a, options.b)
    errors: list[Floats] = []
    depths: list[list[Floats]] = [[], []]
    strains: list[list[Floats]] = [[], []]
    creeps: list[list[Floats]] = [[], []]
    speeds: list[list[float]] = []
    for seed in range(options.seed, options.seed + options.scenes):
        scene = task.scene(options.subtask, seed)
        every, rates = courses(
            task, options.subtask, seed, options.episodes, backends, options.hold
        )
        speeds.append(rates)
        for k, one in enumerate(every):
            creeps[k].append(np.linalg.norm(one[:, -1] - one[:, AT[-1]], axis=-1))
        every = every[:, :, : AT[-1] + 1]
        errors.append(np.linalg.norm(every[1] - every[0], axis=-1))
        probe = Probe(scene.spec)
        for k, one in enumerate(every):
            depths[k].append(probe.depth(one[:, ::EVERY]).ravel())
            strains[k].append(np.abs(edge_strain(scene.model, one)).ravel())
    error = np.concatenate(errors)
    print(f"{options.subtask}: {len(error)} episodes, median / 90 % / greatest")
    for step in AT:
        print(f"vertex error after {step} steps, mm: {words(error[:, step], 1e-3)}")
    for name, creep in zip(backends, creeps, strict=True):
        if options.hold:
            print(f"{name}: moved in {options.hold} more steps, mm: {words(np.array(creep), 1e-3)}")
    for name, depth, strain in zip(backends, depths, strains, strict=True):
        print(f"{name}: penetration, mm: {words(np.concatenate(depth), 1e-3)}")
        print(f"{name}: edge strain, %: {words(np.concatenate(strain), 1e-2)}")
    for name, rates in zip(backends, zip(*speeds, strict=True), strict=True):
        print(f"{name}: control steps in a processor second: {np.median(rates):.3g}")


if __name__ == "__main__":
    main()
