"""Analytic policy gradient: the reward at the end, differentiated through the learned step.

Over whole episodes, as the paper has it, or over short horizons that end in a value function
(short-horizon actor-critic, Xu et al. 2022), where the product of Jacobians is cut.
"""

from __future__ import annotations

import copy
import dataclasses
import math
import warnings
from typing import Any

import torch
from orbisim_world_model.entities import choose
from orbisim_world_model.graphs import Graphed
from orbisim_world_model.optimizer import FlatAdamW
from orbisim_world_model.sampling import generator_of
from orbisim_world_model.stepper import cause
from torch import Tensor

from orbisim.errors import InputError
from orbisim_policies.learned import DifferentiableWorlds, Pool
from orbisim_policies.network import NetworkConfig, Policy, value_network
from orbisim_policies.rollout import Acted, Running, acted, began, observation, worth
from orbisim_policies.rollout import compiled as compile_step

_NONE = -1e9
"""Of objectives: there was none yet."""


@dataclasses.dataclass(frozen=True)
class ApgConfig:
    """How a policy is trained.

    Attributes:
      batch: worlds at once. horizon: control steps that are differentiated; 0 for whole episodes.
      rate, final_rate: of Adam, at the beginning and at the end.
      noise, final_noise: standard deviation of what is added to actions before they are bounded.
      limit: largest norm of the gradient that a world hands back over a step (see `advanced`).
      clip: largest norm of the policy's gradient.
      fall: share of the best objective after the loss of which a training goes back to where it
        was best, with half the rate (whole episodes).
      discount, trace: of values, with a horizon. value_steps: of the value function each time.
      network: of the policy.
    """

    batch: int = 512
    horizon: int = 0
    rate: float = 3e-4
    final_rate: float = 2e-5
    noise: float = 0.2
    final_noise: float = 0.05
    limit: float = 0.1
    clip: float = 1.0
    fall: float = 0.2
    discount: float = 0.99
    trace: float = 0.95
    value_steps: int = 4
    network: NetworkConfig = dataclasses.field(default_factory=NetworkConfig)


class Apg:
    """The policy gradient of section 3.5, one training, resumable to the exact step.

    Args:
      worlds: the step.
      pool: where episodes begin; drawn from it at random.
      config: how to train.
      seed: of weights, starts and noise.
      policy: to go on from; fresh if None.
      graph: run an iteration as one CUDA graph, where there is a GPU.
      compiled: have torch compile a control step with its policy; a minute or two at first.

    Raises:
      InputError: the horizon does not divide the episode.
    """

    def __init__(
        self,
        worlds: DifferentiableWorlds,
        pool: Pool,
        config: ApgConfig,
        *,
        seed: int = 0,
        policy: Policy | None = None,
        graph: bool = True,
        compiled: bool = False,
    ) -> None:
        problem = worlds.problem
        self.horizon = config.horizon or problem.steps
        if problem.steps % self.horizon:
            raise InputError(
                f"a horizon divides the episode of {problem.steps} steps; got {self.horizon}"
            )
        self.worlds, self.pool, self.config, self.seed = worlds, pool, config, seed
        device = worlds.device
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.policy = Policy(problem.observations, problem.actions, config.network)
            self.values = value_network(problem.observations)
        if policy is not None:
            self.policy.load_state_dict(policy.state_dict())
        self.policy.to(device)
        self.values.to(device)
        self.target = copy.deepcopy(self.values).requires_grad_(False)
        self.optimizer = FlatAdamW(self.policy, 0.0, config.clip)
        self.value_optimizer = FlatAdamW(self.values, 0.0, 1.0)
        self.whole = self.horizon == problem.steps
        self.done = 0
        self._best = self.optimizer.values.clone()
        self._level = torch.tensor([_NONE, _NONE, 1.0], device=device)
        self._spread = torch.zeros((), device=device)
        self._starts, self._noise = self._drawn()
        self._running = began(worlds, self._starts)
        phases = torch.arange(config.batch, device=device) % (problem.steps // self.horizon)
        self._running = self._running._replace(done=phases.float() * self.horizon)
        self._graph = graph and device.type == "cuda"
        self._run: Any = None
        self._act: Acted = lambda now, noise: acted(worlds, self.policy, now, noise, config.limit)
        if compiled:
            self._compile()

    def _compile(self) -> None:
        """Has a control step compiled; goes on without where that fails."""
        fast = compile_step(self.worlds, self.policy, self.config.limit)
        try:
            after, _ = fast(self._running.detach(), self._noise[0])
            worth(self.worlds, after).sum().backward()
            self._act = fast
        except Exception as error:  # compilers fail in many ways; the step itself does not
            warnings.warn(f"step not compiled, it is slower: {cause(error)}", stacklevel=3)
        self.optimizer.zero_grad()

    # -- an iteration --------------------------------------------------------------------------

    def step(self, progress: float) -> Tensor:
        """One iteration; `progress` from 0 to 1 sets learning rate and noise.

        Returns:
          [3 + parts]: objective, its share of finite worlds, loss of the values, and the mean of
          each part of the reward where episodes ended.
        """
        config = self.config
        low, high = config.final_rate, config.rate
        rate = low + 0.5 * (high - low) * (1 + math.cos(math.pi * progress))
        self.optimizer.rate.copy_(rate * self._level[2])
        self.value_optimizer.rate.fill_(1e-3)
        self._spread.fill_(config.noise + (config.final_noise - config.noise) * progress)
        fresh, noise = self._drawn()
        _copy((*self._starts, self._noise), (*fresh, noise))
        if self._run is None:
            saved = {name: tensor.clone() for name, tensor in self.state().items()}
            self._run = Graphed(self._iterate, lambda: self._restore(saved), self._graph)
        found: Tensor = self._run().clone()
        self.done += 1
        if self.whole:
            self._look_back(found[0])
        return found

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def _look_back(self, objective: Tensor) -> None:
        """Keeps the best weights; goes back to them, with half the steps, after a fall.

        The objective of many steps in closed loop has cliffs, behind which there is no gradient.
        """
        level, best, scale = self._level
        level = torch.where(level > _NONE / 2, 0.8 * level + 0.2 * objective, objective)
        better = level > best
        best = torch.where(better, level, best)
        fell = level < best - self.config.fall * best.abs()
        optimizer = self.optimizer
        self._best.copy_(torch.where(better, optimizer.values, self._best))
        optimizer.values.copy_(torch.where(fell, self._best, optimizer.values))
        for moment in (optimizer.first, optimizer.second, optimizer.count):
            moment.mul_(1.0 - fell.float())
        self._level.copy_(
            torch.stack([torch.where(fell, best, level), best, scale * (1.0 - 0.5 * fell.float())])
        )

    @property
    def true_steps(self) -> int:
        """Control steps of C MuJoCo that it has made itself."""
        return self.done * self.horizon * self.config.batch * self.worlds.true_per_step

    @property
    def current(self) -> Policy:
        """The policy as it is now."""
        return self.policy

    @property
    def chosen(self) -> Policy:
        """The policy to keep: over whole episodes the best by its objective, else the last."""
        kept = copy.deepcopy(self.policy)
        if self.whole and self._level[1] > _NONE / 2:
            offset = 0
            for p in kept.parameters():
                p.data = self._best[offset : offset + p.numel()].view_as(p).clone()
                offset += p.numel()
        return kept

    def _drawn(self) -> tuple[Pool, Tensor]:
        """Starts and noise of this iteration: of the seed and its number alone."""
        device, config = self.worlds.device, self.config
        generator = generator_of(device, self.seed, self.done)
        size = (config.batch,)
        index = torch.randint(len(self.pool.qpos), size, generator=generator, device=device)
        shape = (self.horizon, config.batch, self.worlds.problem.actions)
        return self.pool.at(index), torch.randn(shape, generator=generator, device=device)

    def _iterate(self) -> Tensor:
        if self.whole:
            return self._whole_episodes()
        return self._short_horizon()

    def _whole_episodes(self) -> Tensor:
        worlds = self.worlds
        self.optimizer.zero_grad()
        now = began(worlds, self._starts)
        for t in range(self.horizon):
            now, _ = self._act(now, self._spread * self._noise[t])
        parts = worth(worlds, now)
        total = parts.sum(1)
        fine = total.isfinite()
        objective = torch.where(fine, total, torch.zeros_like(total)).sum() / fine.sum().clamp_min(
            1
        )
        (-objective).backward()
        self.optimizer.step()
        kept = torch.where(fine[:, None], parts, torch.zeros_like(parts)).sum(0)
        share = fine.float().mean()
        zero = torch.zeros_like(share)
        head = torch.stack([objective.detach(), share, zero])
        return torch.cat([head, (kept / fine.sum().clamp_min(1)).detach()])

    def _short_horizon(self) -> Tensor:
        worlds, config, problem = self.worlds, self.config, self.worlds.problem
        self.optimizer.zero_grad()
        fresh = began(worlds, self._starts)
        now = _restarted(self._running, fresh, self._running.done >= problem.steps)
        seen, rewards = [], []
        before = worth(worlds, now).sum(1)
        for t in range(self.horizon):
            now, view = self._act(now, self._spread * self._noise[t])
            seen.append(view.detach())
            parts = worth(worlds, now)
            after = parts.sum(1)
            ended = now.done >= problem.steps
            if problem.sparse:
                rewards.append(torch.where(ended, after, torch.zeros_like(after)))
            else:
                rewards.append(after - before)
                before = after
        last = self.target(observation(worlds, now))[:, 0]
        last = torch.where(ended, torch.zeros_like(last), last)
        gain = config.discount**self.horizon * last
        for t, reward in enumerate(rewards):
            gain = gain + config.discount**t * reward
        fine = gain.isfinite() & now.x.q.isfinite().all(1)
        count = fine.sum().clamp_min(1)
        objective = torch.where(fine, gain, torch.zeros_like(gain)).sum() / count
        (-objective / self.horizon).backward()
        self.optimizer.step()
        loss = self._fit_values(torch.stack(seen), rewards, last, fine)
        over = (ended & fine).float()
        kept = torch.where(fine[:, None], parts, torch.zeros_like(parts)) * over[:, None]
        mean = kept.sum(0) / over.sum().clamp_min(1)
        # a world that diverged begins anew
        lost = torch.where(fine, now.done, torch.full_like(now.done, float(problem.steps)))
        now = _restarted(now, fresh, ~fine)._replace(done=lost).detach()
        _copy(self._running, now)
        head = torch.stack([objective.detach(), fine.float().mean(), loss])
        return torch.cat([head, mean.detach()])

    def _fit_values(
        self, seen: Tensor, rewards: list[Tensor], last: Tensor, fine: Tensor
    ) -> Tensor:
        """Towards lambda returns of the window (TD(lambda)) by its target network."""
        config = self.config
        with torch.no_grad():
            values = self.target(seen)[..., 0]  # [h, N]
            following, goal, goals = last, last, []
            for t in reversed(range(len(rewards))):
                mixed = (1 - config.trace) * following + config.trace * goal
                goal = rewards[t] + config.discount * mixed
                goals.append(goal)
                following = values[t]
            aim = torch.nan_to_num(torch.stack(goals[::-1]))
        weight = fine.float() / fine.float().sum().clamp_min(1) / len(rewards)
        loss = torch.zeros((), device=seen.device)
        for _ in range(config.value_steps):
            self.value_optimizer.zero_grad()
            error = self.values(torch.nan_to_num(seen))[..., 0] - aim
            loss = (error.square() * weight).sum()
            loss.backward()
            self.value_optimizer.step()
        with torch.no_grad():
            for mine, theirs in zip(
                self.target.parameters(), self.values.parameters(), strict=True
            ):
                mine.lerp_(theirs, 0.2)
        return loss.detach()

    # -- state ---------------------------------------------------------------------------------

    def state(self) -> dict[str, Tensor]:
        """What is needed to go on, by name."""
        found = {f"policy.{k}": v for k, v in self.optimizer.state().items()}
        if self.whole:
            return {**found, "best": self._best, "level": self._level}
        found |= {f"values.{k}": v for k, v in self.value_optimizer.state().items()}
        found |= {f"target.{k}": v for k, v in self.target.state_dict().items()}
        for name, field in zip(Running._fields, self._running, strict=True):
            if isinstance(field, Tensor):
                found[f"running.{name}"] = field
            else:
                found |= {f"running.x.{k}": v for k, v in field._asdict().items()}
        return found

    def restore(self, tensors: dict[str, Tensor], done: int) -> None:
        """Takes what `state` gave after `done` iterations."""
        self._restore(tensors)
        self.done = done

    def _restore(self, tensors: dict[str, Tensor]) -> None:
        with torch.no_grad():
            for name, tensor in self.state().items():
                tensor.copy_(tensors[name])


def _restarted(now: Running, fresh: Running, which: Tensor) -> Running:
    """The worlds, with those [N] begun anew."""

    def pick(a: Tensor, b: Tensor) -> Tensor:
        return torch.where(which.reshape(-1, *([1] * (a.dim() - 1))), a, b)

    fields = [pick(a, b) for a, b in zip(fresh[1:], now[1:], strict=True)]
    return Running(choose(which, fresh.x, now.x), *fields)


def _copy(into: Any, values: Any) -> None:
    """In place, tensor by tensor."""
    for target, value in zip(into, values, strict=True):
        if isinstance(target, Tensor):
            target.copy_(value)
        else:
            _copy(target, value)
