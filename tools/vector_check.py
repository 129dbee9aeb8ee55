"""Compares `orbisim.vector` with dm_control's environments, world by world and bit for bit.

    python tools/vector_check.py --steps 1000 --nworld 3

Every task of the suite takes random actions in a few worlds; each world has a dm_control
environment of its own beside it. Observations, rewards and ends of episodes must be equal to the
bit, resets included (a time limit below the number of steps makes them happen). Where dm_control
raises `PhysicsError`, the world must have diverged; both then begin an episode.
"""

from __future__ import annotations

import argparse
import dataclasses
import logging
import sys
from typing import Any

import dm_env
import from_source  # noqa: F401
import numpy as np
import numpy.typing as npt
from dm_control import suite
from dm_control.rl import control

import orbisim


@dataclasses.dataclass
class Outcome:
    """steps: of all worlds together. resets: ends of episodes. first: the first difference."""

    evaluation: str
    steps: int = 0
    resets: int = 0
    diverged: int = 0
    first: str = ""


def differs(
    step: Any, world: int, theirs: dm_env.TimeStep, observation: dict[str, npt.NDArray[Any]]
) -> str:
    """What is not dm_control's in one world; empty if all is."""
    for name, value in theirs.observation.items():
        if not np.array_equal(observation[name][world], value, equal_nan=True):
            return name
    if step is None:
        return ""
    reward = 0.0 if theirs.first() else theirs.reward
    ended = theirs.last()
    pairs = {
        "reward": (step.reward[world], reward),
        "terminated": (step.terminated[world], ended and theirs.discount == 0.0),
        "truncated": (step.truncated[world], ended and theirs.discount != 0.0),
    }
    return next((name for name, (mine, other) in pairs.items() if mine != other), "")


def compare(
    domain: str, task: str, nworld: int, steps: int, seed: int = 0, time_limit: float | None = None
) -> Outcome:
    """Runs one task both ways."""
    kwargs = {} if time_limit is None else {"time_limit": time_limit}
    ours = orbisim.vector.load(domain, task, nworld, seed=seed, task_kwargs=kwargs)
    theirs = [
        suite.load(domain, task, task_kwargs={"random": seed + world, **kwargs})
        for world in range(nworld)
    ]
    outcome = Outcome(ours.evaluation)
    spec = ours.action_spec()
    low, high = np.maximum(spec.minimum, -1.0), np.minimum(spec.maximum, 1.0)
    random = np.random.default_rng(seed)
    observation = ours.reset()
    firsts = [environment.reset() for environment in theirs]
    bad = [differs(None, w, first, observation) for w, first in enumerate(firsts)]
    for number in range(steps):
        if any(bad):
            world = next(w for w, name in enumerate(bad) if name)
            outcome.first = f"world {world} before step {number}: {bad[world]}"
            return outcome
        action = random.uniform(low, high, (nworld, *spec.shape))
        step = ours.step(action)
        pairs = enumerate(zip(theirs, action, strict=True))
        bad = [_one(ours, step, w, one, a, outcome) for w, (one, a) in pairs]
        outcome.steps += nworld
    return outcome


def _one(
    ours: Any,
    step: Any,
    world: int,
    theirs: control.Environment,
    action: npt.NDArray[Any],
    outcome: Outcome,
) -> str:
    try:
        result = theirs.step(action)
    except control.PhysicsError:
        theirs._reset_next_step = True
        outcome.diverged += 1
        return "" if step.truncated[world] and ours.diverged[world] else "divergence"
    outcome.resets += result.first()
    return differs(step, world, result, step.observation)


def main() -> None:
    """Prints a table, and exits with 1 if anything differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--nworld", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--time-limit", type=float, default=None, help="of an episode, s")
    parser.add_argument("--only", nargs="*", default=None, help="domain-task ...")
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    failed = 0
    print("| task | evaluation | steps | resets | diverged | equal |")
    print("| --- | --- | --- | --- | --- | --- |", flush=True)
    for domain, task in orbisim.suite.ALL_TASKS:
        if options.only and f"{domain}-{task}" not in options.only:
            continue
        found = compare(
            domain, task, options.nworld, options.steps, options.seed, options.time_limit
        )
        failed += bool(found.first)
        print(
            f"| {domain}-{task} | {found.evaluation} | {found.steps} | {found.resets} "
            f"| {found.diverged} | {found.first or 'yes'} |",
            flush=True,
        )
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
