"""`DeviceEnvironment`: many worlds of a problem in the learned step, all on the device."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import torch
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.graphs import Graphed
from orbisim_world_model.guard import Guard
from orbisim_world_model.manifest import read_manifest
from orbisim_world_model.stepper import Speedups, Stepper, cause
from orbisim_world_model.watch import OutsideTrainingWarning
from torch import Tensor

from orbisim.arguments import whole_number
from orbisim.errors import InputError
from orbisim.vector.environment import FLAT, Step
from orbisim_policies.learned import LearnedWorlds
from orbisim_policies.problem import Problem
from orbisim_policies.rollout import Running, advanced, began, observation

_FIELDS = len(Entities._fields)
_VIEW, _OVER = -5, -3
"""Where in the state of all worlds the observation, and whether the episode is over, stand."""


class DeviceEnvironment:
    """Observations, learned step, rewards, ends of episodes and new episodes without the host.

    Autoreset is that of `orbisim.vector.VectorEnvironment`: the step after the last one of an
    episode ignores the action and returns the first observation of the next one with reward 0. A
    sparse problem's reward is given with the last step, which terminates the episode; other
    problems give dm_control's own reward with each, and their time limit truncates. A world whose
    step is no physical state (see `guard`) is truncated with reward 0 and the observation before
    it, and counted in `diverged`.

    Args:
      problem: what is to be done, see `problems.make_problem`.
      nworld: number of worlds.
      checkpoint: folder of the dynamics; the zoo's that fits if None.
      device: where to compute; None for the GPU, if there is one.
      seed: of the first of the starts.
      starts: how many starts are drawn, on the host and once. World i begins with start i and goes
        on by `nworld` of them, modulo their number.
      compiled: on a GPU, compile by torch.
      half: on a GPU, compute the network in half precision.

    Attributes:
      diverged: [nworld] how often each world has diverged.
      outside: [nworld, K] whether each entity has left the training data, in this episode.
      entity_names: of the K entities.

    Raises:
      InputError: the numbers are none, or the checkpoint is not one for the problem.
      UnsupportedSceneError: the checkpoint does not fit the scene.
    """

    def __init__(
        self,
        problem: Problem,
        nworld: int,
        checkpoint: str | Path | None = None,
        device: str | None = None,
        *,
        seed: int = 0,
        starts: int = 1024,
        compiled: bool = True,
        half: bool = True,
    ) -> None:
        self.nworld = whole_number("nworld", nworld, 1)
        count, seed = whole_number("starts", starts, 1), whole_number("seed", seed, 0)
        self.device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        self.problem = problem.to(self.device)
        worlds = LearnedWorlds(self.problem, checkpoint, self.device)
        speedups = Speedups(precision="fp16" if half else "fp32", compiled=None)
        worlds.model = Stepper(worlds.model.eval(), self.device, speedups).fastest
        self.worlds = worlds
        self.guard = Guard(read_manifest(worlds.folder), worlds.layout, self.problem.scene.model)
        self.entity_names = self.guard.names
        with torch.no_grad():
            pool = worlds.pool(self.problem.draw(range(seed, seed + count)))
            starts_of = began(worlds, pool)
            view, total = observation(worlds, starts_of), self._worth(starts_of)
        left = self.guard.outside(starts_of.x)
        # of each start: what an episode begins with
        self._starts = [*starts_of.x, *starts_of[1:], total, view, left]
        index = torch.arange(self.nworld, device=self.device) % count
        begun = [rows[index] for rows in self._starts]
        over = torch.zeros(self.nworld, dtype=torch.bool, device=self.device)
        self.diverged = torch.zeros(self.nworld, dtype=torch.int64, device=self.device)
        self.outside = begun[-1]
        self._action = torch.zeros((self.nworld, self.problem.actions), device=self.device)
        # worlds' own numbers, in the order of `_moved`
        self._state = [*begun, over, index, self.diverged]
        self._compiled = compiled and self.device.type == "cuda"
        self._run: Graphed | None = None
        self._steps, self._warned = 0, False

    def reset(self) -> dict[str, Tensor]:
        """Starts an episode in every world, each with its first start.

        Returns:
          `observations` [nworld, F].
        """
        index = torch.arange(self.nworld, device=self.device) % len(self._starts[0])
        begun = [rows[index] for rows in self._starts]
        begun += [torch.zeros_like(self._state[_OVER]), index]
        for mine, given in zip(self._state, begun, strict=False):  # what has diverged is kept
            mine.copy_(given)
        self._steps = 0
        return {FLAT: self._state[_VIEW].clone()}

    def step(self, action: Tensor) -> Step:
        """One control step in every world; in those whose episode is over, a reset.

        What left the training data is warned of once, looked for every episode's length.

        Args:
          action: [nworld, A] on the device, each from -1 to 1.

        Returns:
          `observation` with `observations` [nworld, F], `reward`, `terminated` and `truncated`
          [nworld], on the device.

        Raises:
          InputError: the action has another shape.
        """
        if tuple(action.shape) != tuple(self._action.shape):
            raise InputError(
                f"action has shape {tuple(action.shape)}; expected {tuple(self._action.shape)}"
            )
        with torch.no_grad():
            self._action.copy_(action)
            if self._run is None:
                self._run = self._prepared()
            found = self._run()
            view, reward, terminated, truncated = (tensor.clone() for tensor in found)
        self._steps += 1
        if not self._warned and self._steps % self.problem.steps == 0:
            self._warn()
        return Step({FLAT: view}, reward, terminated, truncated)

    # -- inner workings --------------------------------------------------------------------------

    def _prepared(self) -> Graphed:
        """The step, compiled if that is possible, as one graph that works on the state."""
        step: Any = self._moved
        kept = [tensor.clone() for tensor in self._state]
        now = Running(Entities(*self._state[:_FIELDS]), *self._state[_FIELDS : _VIEW - 1])
        control = self.problem.control(now.command, self._action)[0]
        context = Context(now.attributes, now.settings, None)
        self.worlds.model.tune(now.x, self.worlds._memory, control, context)
        if self._compiled:
            fast = torch.compile(self._moved, dynamic=False, fullgraph=True)
            try:
                fast(self._action, *self._state)
                step = fast
            except Exception as error:  # compilers fail in many ways; the step itself does not
                text = f"environment not compiled, it is slower: {cause(error)}"
                warnings.warn(text, stacklevel=4)

        def once() -> tuple[Tensor, ...]:
            *state, reward, terminated, truncated = step(self._action, *self._state)
            for mine, new in zip(self._state, state, strict=True):
                mine.copy_(new)
            return self._state[_VIEW], reward, terminated, truncated

        def restore() -> None:
            for mine, given in zip(self._state, kept, strict=True):
                mine.copy_(given)

        return Graphed(once, restore, self.device.type == "cuda")

    def _moved(self, action: Tensor, *given: Tensor) -> tuple[Tensor, ...]:
        """The state after a step, reward, and how episodes ended; from tensors to tensors."""
        *running, total, view, outside, over, index, diverged = given
        now = Running(Entities(*running[:_FIELDS]), *running[_FIELDS:])
        worlds, problem, guard = self.worlds, self.problem, self.guard
        start = Entities(*(rows[index] for rows in self._starts[:_FIELDS]))
        after = advanced(worlds, now, action, 0.0)
        worth, seen = self._worth(after), observation(worlds, after)
        late = after.done >= problem.steps
        if problem.sparse:
            reward = torch.where(late, worth, 0.0)
        else:
            reward = (worth - total) * problem.steps
        lost = guard.lost(after.x, start).any(-1) | ~torch.isfinite(reward)
        lost, late = lost & ~over, late & ~over & ~lost
        seen = torch.where(lost[:, None], view, seen)
        terminated = late if problem.sparse else torch.zeros_like(late)
        truncated = lost | (late & ~terminated)
        # worlds whose episode is over begin the next one instead
        index = torch.where(over, (index + self.nworld) % len(self._starts[0]), index)
        moved = [*after.x, *after[1:], worth, seen, outside | guard.outside(after.x)]
        state = [
            torch.where(over.reshape(-1, *([1] * (mine.dim() - 1))), rows[index], mine)
            for rows, mine in zip(self._starts, moved, strict=True)
        ]
        reward = torch.where(over | lost, 0.0, reward)
        kept = (terminated | truncated, index, diverged + lost)
        return (*state, *kept, reward, terminated, truncated)

    def _worth(self, now: Running) -> Tensor:
        """[nworld]: what the episode is worth if it ends here, by the task's own reward."""
        qpos = self.worlds.coordinates(now.x)[0]
        return self.problem.measure(now.score, qpos).sum(1)

    def _warn(self) -> None:
        """Says once which entities have left the training data, in how many worlds."""
        counts = self.outside.sum(0).tolist()
        found = [f"{n!r} in {c}" for n, c in zip(self.entity_names, counts, strict=True) if c]
        if found:
            self._warned = True
            text = f"of {self.nworld} worlds, these left the training data: {', '.join(found)}"
            warnings.warn(f"{self.problem.name}: {text}", OutsideTrainingWarning, stacklevel=3)
