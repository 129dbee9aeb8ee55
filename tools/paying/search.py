"""A search by the cross-entropy method, for motions that are over before feedback could help."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import torch
from orbisim_policies.evaluate import starts_of
from orbisim_policies.problem import Floats
from orbisim_policies.true import TrueWorlds
from safetensors.torch import load_file, save_file
from torch import Tensor

from paying.duty import Duty

POPULATION, ELITE, STARTS = 48, 8, 6
"""Motions that are tried each time, how many say where to look next, and starts that all have."""
KNOTS = 6
"""Moments of a motion between which actions are interpolated."""
_SPREAD, _LEAST = 1.0, 0.02
"""Of the weights at first: actions fill their range; and added, so that the search goes on."""


@dataclasses.dataclass(frozen=True)
class Motion:
    """An action at each moment, that grows with what is asked for.

    Attributes:
      weights: [..., 2, KNOTS], of one motion, or one for each world.
      asked, time: columns of the observation.
    """

    weights: Tensor
    asked: int
    time: int

    def __call__(self, observation: Tensor) -> Tensor:
        """Actions [N, 1] of observations [N, F]."""
        place = (observation[:, self.time] * (KNOTS - 1)).clamp(0, KNOTS - 1.001)
        before = place.long()
        share = (place - before)[:, None]
        weights = self.weights.expand(len(observation), 2, KNOTS)
        index = before[:, None, None].expand(-1, 2, 1)
        low, high = (weights.gather(2, index + i)[..., 0] for i in (0, 1))
        knots = (1 - share) * low + share * high
        return (knots[:, :1] + knots[:, 1:] * observation[:, self.asked, None]).clamp(-1, 1)

    def cpu(self) -> Motion:
        """Where it is anyway."""
        return self


def search(duty: Duty, columns: tuple[int, int], steps: int, seed: int) -> Motion:
    """The motion with the highest mean reward that so many control steps of MuJoCo find."""
    rng = np.random.default_rng([seed, 3])
    mean, spread = np.zeros((2, KNOTS)), np.full((2, KNOTS), _SPREAD)
    starts = starts_of(duty, STARTS, seed, "search")
    every = starts.at(np.tile(np.arange(STARTS), POPULATION))
    rounds = max(1, steps // (POPULATION * STARTS * duty.steps))
    worlds = TrueWorlds(duty, len(every), nthread=1)
    for _ in range(rounds):
        tried = mean + spread * rng.normal(size=(POPULATION, 2, KNOTS))
        weights = torch.as_tensor(np.repeat(tried, STARTS, axis=0)).float()
        motion = Motion(weights, *columns)
        worlds.begin(np.arange(len(every)), every)
        lost = np.zeros(len(every), bool)
        for _ in range(duty.steps):
            lost |= worlds.step(motion(worlds.observation()))
        worth = torch.nan_to_num(worlds.measure()[:, 0]).double().numpy()
        score = np.where(lost, 0.0, worth).reshape(POPULATION, STARTS).mean(1)
        best: Floats = tried[np.argsort(score)[-ELITE:]]
        mean, spread = best.mean(0), best.std(0) + _LEAST
    worlds.close()
    return Motion(torch.as_tensor(mean).float(), *columns)


def save(motion: Motion, path: Path) -> None:
    """Writes the weights."""
    save_file({"weights": motion.weights.contiguous()}, str(path))


def load(path: Path, columns: tuple[int, int]) -> Motion:
    """Reads what `save` wrote."""
    return Motion(load_file(str(path))["weights"], *columns)
