"""How good a policy is: in MuJoCo, and beside it inside the model that it was trained in."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

from orbisim.host.progress import track
from orbisim.tasks.sampling import episode_seed
from orbisim_policies.learned import LearnedWorlds
from orbisim_policies.problem import Floats, Problem, Starts
from orbisim_policies.rollout import play
from orbisim_policies.true import TrueWorlds

Act = Callable[[torch.Tensor], torch.Tensor]
"""From observations [N, F] to actions [N, A]."""

_NORMAL = 1.959963984540054
"""Quantile of a 95 % interval."""
_AT_ONCE = 256  # worlds side by side: more make no thread busier and take memory


def starts_of(problem: Problem, episodes: int, seed: int, purpose: str = "evaluation") -> Starts:
    """Where the episodes of a seed begin; those of one purpose are never those of another."""
    return problem.draw(seeds_of(problem, episodes, seed, purpose))


def seeds_of(problem: Problem, episodes: int, seed: int, purpose: str = "evaluation") -> list[int]:
    """Of the episodes of `starts_of`."""
    return [episode_seed(seed, problem.name, f"policy {purpose}", i) for i in range(episodes)]


def wilson(successes: int, count: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927)."""
    share, z = successes / count, _NORMAL
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z * math.sqrt(share * (1 - share) / count + z * z / (4 * count * count))
    half /= 1 + z * z / count
    low, high = max(middle - half, 0.0), min(middle + half, 1.0)
    return (low if successes else 0.0), (high if successes < count else 1.0)


def begun(act: Any, count: int) -> Act:
    """What acts through so many episodes from their beginning: a policy may remember."""
    found: Act = act.begin(count) if hasattr(act, "begin") else act
    return found


def in_mujoco(
    problem: Problem,
    act: Act,
    starts: Starts,
    nthread: int = 0,
    nominal: bool = False,
    shown: bool = False,
) -> tuple[Floats, Floats, int]:
    """Episodes in C MuJoCo: qpos at the end, `measure` [N, parts], and how many diverged.

    What diverges, or has no finite reward, counts as if nothing had been done: it ends where it
    began, with no value. With `nominal`, observations have nominal values of what no image shows.
    With `shown`, a bar says how far it is.
    """
    ends, values, lost = [], [], 0
    for first in range(0, len(starts), _AT_ONCE):
        part = starts.at(slice(first, first + _AT_ONCE))
        with contextlib.closing(TrueWorlds(problem, len(part), nthread, nominal)) as worlds:
            worlds.begin(np.arange(len(part)), part)
            alive, end = np.arange(len(part)), part.qpos.copy()
            playing = begun(act, len(part))
            steps = range(problem.steps)
            for _ in track(steps, "playing in MuJoCo") if shown else steps:
                with torch.no_grad():
                    action = playing(worlds.observation())
                alive = alive[~worlds.step(action, alive)[alive]]
                end[alive] = worlds.coordinates[0][alive]
                if not len(alive):
                    break
            value = worlds.measure().double().numpy()
        well = alive[np.isfinite(value[alive]).all(axis=1)]
        gone = np.setdiff1d(np.arange(len(part)), well)
        end[gone] = part.qpos[gone]
        value[gone] = 0.0
        lost += len(gone)
        ends.append(end)
        values.append(value)
    return np.concatenate(ends), np.concatenate(values), lost


def in_model(worlds: LearnedWorlds, policy: Any, starts: Starts) -> tuple[Floats, Floats]:
    """The same episodes inside the learned step: qpos at the end and `measure`."""
    problem = worlds.problem
    now = play(worlds, policy.to(worlds.device), worlds.pool(starts))
    qpos, _ = worlds.coordinates(now.x)
    return qpos.double().cpu().numpy(), problem.measure(now.score, qpos).double().cpu().numpy()


def summary(problem: Problem, starts: Starts, qpos: Floats, value: Floats) -> dict[str, Any]:
    """Shares of success with 95 % intervals by definition, and the mean of each reward."""
    found = problem.success(starts, qpos, value)
    count = len(value)
    shares = {
        name: {
            "share": float(np.mean(row)),
            "ci95": list(wilson(int(np.sum(row)), count)),
            "successes": int(np.sum(row)),
        }
        for name, row in found.items()
    }
    named = zip(problem.parts, value.T, strict=True)
    spread = {
        name: {
            "mean": float(row.mean()),
            "ci95_half": float(_NORMAL * row.std(ddof=1) / math.sqrt(count)) if count > 1 else 0.0,
        }
        for name, row in named
    }
    return {"episodes": count, "success": shares, "reward": spread}


def evaluate(
    problem: Problem,
    policy: Any,
    *,
    episodes: int = 200,
    seeds: Sequence[int] = (0, 1, 2),
    worlds: LearnedWorlds | None = None,
    nthread: int = 0,
    nominal: bool = False,
) -> dict[str, Any]:
    """Success of a policy over episodes of several seeds, in MuJoCo and in the model.

    Args:
      problem: on the CPU. policy: from observations to actions.
      episodes: of each seed. seeds: of the episodes.
      worlds: the model to compare with; none if None.
      nthread: threads that step MuJoCo; 0 for one per usable core.
      nominal: see `in_mujoco`; of MuJoCo alone.
    """
    drawn = [starts_of(problem, episodes, seed) for seed in seeds]
    everything = joined(drawn)
    qpos, value, lost = in_mujoco(problem, policy.cpu(), everything, nthread, nominal, shown=True)
    result: dict[str, Any] = {
        "schema": "orbisim.eval_policy/1",
        "task": problem.name,
        "seeds": list(seeds),
        "episodes_per_seed": episodes,
        "diverged": lost,
        "mujoco": summary(problem, everything, qpos, value),
        "by_seed": [
            summary(problem, starts, qpos[part], value[part])
            for starts, part in zip(drawn, _parts(len(seeds), episodes), strict=True)
        ],
    }
    if worlds is not None:
        inside = in_model(worlds, policy, everything)
        result["model"] = summary(problem, everything, *inside)
        policy.cpu()
    return result


def _parts(count: int, size: int) -> list[slice]:
    return [slice(i * size, (i + 1) * size) for i in range(count)]


def joined(drawn: Sequence[Starts]) -> Starts:
    """One after the other."""
    names = ("qpos", "qvel", "ctrl", "command", "params")
    return Starts(*(np.concatenate([getattr(one, name) for one in drawn]) for name in names))


def as_float(values: Any) -> torch.Tensor:
    """An array as float32."""
    return torch.as_tensor(np.asarray(values), dtype=torch.float32)
