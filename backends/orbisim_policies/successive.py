"""Episodes in C MuJoCo that follow each other in every world: where methods learn by trying."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbisim_policies.problem import Problem, Starts
from orbisim_policies.true import TrueWorlds

Flags = npt.NDArray[np.bool_]


class Turn(NamedTuple):
    """What a control step led to.

    Attributes:
      view: [N, F] what is seen now; in an episode that has just begun, its first.
      last: [N, F] what the step itself led to.
      reward: [N]. done: [N] whether an episode ended with it.
      cut: [N] whether it was only cut off: there would be more to gain.
      lost: [N] whether the world diverged or had no finite reward.
      parts: [N, parts] what episodes are worth so far.
    """

    view: Tensor
    last: Tensor
    reward: npt.NDArray[np.float32]
    done: Flags
    cut: Flags
    lost: Flags
    parts: Tensor


class SuccessiveEpisodes:
    """A problem's episodes in C MuJoCo, one after the other in each world.

    A world that diverges, or whose reward is not finite, begins anew; the others go on. Its last
    reward is 0, and `worlds.diverged` counts it.

    Args:
      problem: on the CPU. nworld: number of worlds.
      starts: where episodes begin; drawn from at random.
      seed: of the drawing. nthread: of MuJoCo.
    """

    def __init__(
        self, problem: Problem, nworld: int, starts: Starts, seed: int = 0, nthread: int = 0
    ) -> None:
        self.problem, self.starts, self.nworld = problem, starts, nworld
        self.worlds = TrueWorlds(problem, nworld, nthread)
        self._seed, self._draws = seed, 0
        self._index = np.zeros(nworld, np.int64)
        self._before = torch.zeros(nworld)

    def reset(self) -> Tensor:
        """An episode in every world; what is seen then [N, F]."""
        self._begin(np.arange(self.nworld))
        return self.worlds.observation()

    def step(self, action: Tensor) -> Turn:
        """One control step [N, A] in every world; those whose episode ends begin the next one."""
        lost = self.worlds.step(action)
        parts = self.worlds.worth().clone()
        total = parts.sum(1)
        over = self.worlds.over
        if self.problem.sparse:
            reward = np.where(over, total.numpy(), 0.0)
        else:
            reward = (total - self._before).numpy() * self.problem.steps
            self._before = total.clone()
        broken = ~np.isfinite(reward) & ~lost
        self.worlds.diverged += broken
        lost |= broken
        reward = np.where(lost, 0.0, reward).astype(np.float32)
        done, last = over | lost, torch.nan_to_num(self.worlds.observation())
        cut = done & (lost | (not self.problem.sparse))
        view = last
        if done.any():
            self._begin(np.flatnonzero(done))
            view = self.worlds.observation()
        return Turn(view, last, reward, done, cut, lost, parts)

    def state(self) -> dict[str, Tensor]:
        """All that episodes go on from, by name."""
        mine = {
            "index": torch.as_tensor(self._index),
            "before": self._before,
            "draws": torch.tensor(self._draws),
        }
        return mine | self.worlds.state()

    def restore(self, tensors: Mapping[str, Tensor]) -> None:
        """Takes what `state` gave."""
        self._index = tensors["index"].numpy().copy()
        self.worlds.begin(np.arange(self.nworld), self.starts.at(self._index))
        self.worlds.restore(tensors)
        self._before = tensors["before"].clone()
        self._draws = int(tensors["draws"])

    def close(self) -> None:
        """Frees the worlds."""
        self.worlds.close()

    def _begin(self, worlds: npt.NDArray[np.int64]) -> None:
        rng = np.random.default_rng((self._seed, self._draws))
        self._draws += 1
        self._index[worlds] = rng.integers(len(self.starts), size=len(worlds))
        self.worlds.begin(worlds, self.starts.at(self._index[worlds]))
        self._before[torch.as_tensor(worlds)] = 0.0
