"""One policy: trained under a condition, tried on the machine."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from orbisim_policies.checkpoint import MANIFEST, load_policy
from orbisim_policies.evaluate import in_mujoco, starts_of, summary
from orbisim_policies.network import NetworkConfig
from orbisim_policies.run import Run

from orbisim.files.writing import make_folder
from paying.conditions import DUTIES, PLACES, machine
from paying.duty import Duty
from paying.search import load, save, search

WORLDS, WINDOW, RATE = 32, 128, 1e-3
"""Of PPO: worlds at once, control steps between updates, and Adam's rate at the beginning."""
SEARCHED = 3
"""Times as many steps as PPO has are searched: without learning they cost a third."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """What is asked of a run.

    Attributes:
      scene, condition, seed: which policy. work: folder of all that is made on the way.
      steps: of training, control steps. episodes: of each trial.
      patience, fit: seconds for a diagnosis, and for learning a correction.
    """

    scene: str
    condition: str
    seed: int
    work: Path
    steps: int
    episodes: int
    patience: float
    fit: float

    @property
    def key(self) -> tuple[str, str, int]:
        """Which policy."""
        return self.scene, self.condition, self.seed


def train(plan: Plan) -> dict[str, Any]:
    """Trains one policy and tries it on the machine; a training that was killed goes on."""
    torch.set_num_threads(1)
    began, kind = time.monotonic(), DUTIES[plan.scene]
    folder = plan.work / plan.scene / str(plan.seed)
    seconds = plan.fit if plan.condition == "hybrid" else plan.patience
    problem, notes = PLACES[plan.condition](kind, plan.seed, folder, seconds)
    learn = _learned if problem.columns is None else _searched
    policy = learn(plan, problem, folder / "policies" / plan.condition)
    found: dict[str, Any] = dict(zip(("scene", "condition", "seed"), plan.key, strict=True))
    found |= {"steps": plan.steps * (1 if problem.columns is None else SEARCHED), **notes}
    for name, place in (("machine", kind(machine(kind))), ("own", problem)):
        found[name] = tried(place, policy, plan.episodes, plan.seed)
    return {**found, "seconds": round(time.monotonic() - began, 1)}


def _learned(plan: Plan, problem: Duty, out: Path) -> Any:
    """By PPO."""
    # here, so that the rest needs no Stable-Baselines3
    from orbisim_policies.baselines import Baseline, train_baseline

    if not (out / MANIFEST).exists():
        network = NetworkConfig((64, 64))
        config = Baseline("ppo", batch=WORLDS, window=WINDOW, rate=RATE, network=network)
        run = Run(out, steps=plan.steps, seed=plan.seed, check=0, nthread=1, resume=out.exists())
        train_baseline(problem, config, run)
    return load_policy(out, problem)


def _searched(plan: Plan, problem: Duty, out: Path) -> Any:
    """By the cross-entropy method."""
    path, columns = out / "motion.safetensors", problem.columns
    assert columns is not None
    if not path.exists():
        make_folder(out)
        save(search(problem, columns, SEARCHED * plan.steps, plan.seed), path)
    return load(path, columns)


def tried(place: Duty, policy: Any, episodes: int, seed: int) -> dict[str, Any]:
    """Success, reward and misses of a policy in C MuJoCo, or what corrects it."""
    starts = starts_of(place, episodes, seed)
    qpos, value, lost = in_mujoco(place, policy, starts, nthread=1)
    found = summary(place, starts, qpos, value)
    missed = place.missed(starts, qpos, value)
    quartiles = np.percentile(missed, [25, 50, 75]).tolist()
    return {
        "episodes": episodes,
        **found["success"]["success"],
        "reward": found["reward"]["reward"],
        "miss": dict(zip(("p25", "median", "p75"), quartiles, strict=True)),
        "diverged": lost,
    }
