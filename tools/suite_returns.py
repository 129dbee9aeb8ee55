"""Returns of the suite's feedback policies under `learned` and under `mujoco`.

`eval_dynamics.py --only returns` runs this.
"""

from __future__ import annotations

import functools
import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import from_source
import numpy as np

NUDGE = 1e-4
"""Standard deviation of the noise on velocities at every control step of `nudged`, m/s or rad/s."""


def table(checkpoints: dict[str, Path], seeds: int, workers: int) -> dict[str, Any]:
    """Mean return, and its standard error, of the same episodes under each backend; `apart` is the
    mean of the paired differences over MuJoCo's mean, `apart_error` its standard error. Episodes in
    which a backend diverges count as `diverged`, and not in the differences.

    `nudged` is C MuJoCo with noise on velocities: two runs of a chaotic system are no closer to
    each other than this.

    Args:
      checkpoints: of each domain.
      seeds: episodes of each domain.
      workers: processes.
    """
    found: dict[str, Any] = {}
    for domain, checkpoint in checkpoints.items():
        rows: dict[str, Any] = {}
        totals: dict[str, Any] = {}
        kinds = {
            "mujoco": ("mujoco", 0.0),
            "nudged": ("mujoco", NUDGE),
            "learned": (f"learned:{checkpoint}", 0.0),
        }
        for name, (backend, nudge) in kinds.items():
            run = functools.partial(episode_return, domain, backend, nudge)
            totals[name] = np.array(_in_processes(run, seeds, workers))
            whole = totals[name][np.isfinite(totals[name])]
            spread = float(np.std(whole)) / max(len(whole), 1) ** 0.5
            rows[name] = {"mean": float(np.mean(whole)), "standard_error": spread}
            rows[name]["diverged"] = seeds - len(whole)
        exact = totals["mujoco"]
        differences = {name: totals[name] - exact for name in ("nudged", "learned")}
        kept = {name: d[np.isfinite(d)] for name, d in differences.items()}
        mean = abs(rows["mujoco"]["mean"])
        rows["apart"] = {name: float(d.mean()) / mean for name, d in kept.items()}
        rows["apart_error"] = {
            name: float(d.std(ddof=1)) / len(d) ** 0.5 / mean for name, d in kept.items()
        }
        found[domain] = rows
        print(json.dumps({domain: rows}), flush=True)
    return found


def _in_processes(run: Callable[[int], float], seeds: int, workers: int) -> list[float]:
    """A result for each seed."""
    if workers < 2:
        return [run(seed) for seed in range(seeds)]
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        return list(pool.map(run, range(seeds)))


def episode_return(domain: str, backend: str, nudge: float, seed: int) -> float:
    """Return of an episode of the domain's feedback policy (a rhythm, where it has none); NaN where
    the backend diverges."""
    import torch

    from_source.register("mujoco", "learned", "null")
    from orbisim import suite
    from orbisim.errors import DivergedError
    from orbisim.tasks.domains import SUITE_DOMAINS
    from orbisim.tasks.suite_feedback import feedback, has_feedback
    from orbisim.tasks.suite_policies import rhythm

    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    environment = suite.load(domain, SUITE_DOMAINS[domain], task_kwargs={"random": seed})
    step = environment.reset()
    physics, rng = environment.physics, np.random.default_rng(seed)
    physics.use_backend(backend)
    model, period = physics.model.ptr, environment.control_timestep()
    known = has_feedback(domain)
    policy = feedback(domain, model, period) if known else rhythm(model, rng, period)
    total = 0.0
    while not step.last():
        if nudge:
            physics.data.ptr.qvel[:] += nudge * rng.standard_normal(model.nv)
        try:
            step = environment.step(policy(physics.data.ptr))
        except DivergedError:
            return float("nan")
        total += step.reward or 0.0
    return total
