"""Tasks of dm_control's suite whose rewards are written in tensors."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
import torch
from torch import Tensor

from orbisim import suite
from orbisim.scene import Scene
from orbisim_policies.problem import Floats, Moment, Problem, Starts


class Task(NamedTuple):
    """A task's reward.

    Attributes:
      exact: dm_control's own reward of qpos, qvel and control, [N].
      smooth: what is learned from where `exact` is flat almost everywhere; the same otherwise.
      hinges: which joints turn. success: a mean reward from which an episode has succeeded.
    """

    exact: Callable[[Tensor, Tensor, Tensor], Tensor]
    smooth: Callable[[Tensor, Tensor, Tensor], Tensor]
    hinges: tuple[bool, ...]
    success: float


def _cartpole(qpos: Tensor, qvel: Tensor, control: Tensor) -> Tensor:
    upright = (qpos[:, 1].cos() + 1) / 2
    centered = (1 + _gaussian(qpos[:, 0] / 2.0)) / 2
    small = (4 + (1 - control[:, 0].square()).clamp_min(0.0)) / 5
    slow = (1 + _gaussian(qvel[:, 1] / 5.0)) / 2
    return upright * small * slow * centered


def _pendulum(qpos: Tensor, qvel: Tensor, control: Tensor) -> Tensor:
    return (qpos[:, 0].cos() >= math.cos(math.radians(8))).to(qpos.dtype)


def _pendulum_smooth(qpos: Tensor, qvel: Tensor, control: Tensor) -> Tensor:
    upright = (qpos[:, 0].cos() + 1) / 2
    return upright * (1 + upright * _gaussian(qvel[:, 0] / 5.0)) / 2


def _gaussian(x: Tensor) -> Tensor:
    """dm_control's `tolerance` with its default sigmoid and value at the margin, 0.1."""
    return (math.log(0.1) * x.square()).exp()


SUITE: Mapping[str, Task] = {
    "cartpole-swingup": Task(_cartpole, _cartpole, (False, True), 0.6),
    "pendulum-swingup": Task(_pendulum, _pendulum_smooth, (True,), 0.6),
}


def _document(domain: str) -> mujoco.MjSpec:
    """dm_control's own MJCF of a domain."""
    module = importlib.import_module(f"dm_control.suite.{domain}")
    text, assets = module.get_model_and_assets()
    return mujoco.MjSpec.from_string(*(text.decode(), assets))


class SuiteProblem(Problem):
    """A task of the suite; actions are its controls.

    Args:
      task: `domain-task`, one of `SUITE`.
      steps: of an episode; dm_control's if None.
    """

    parts = ("return",)
    sparse = False

    def __init__(self, task: str, steps: int | None = None) -> None:
        self.name = f"suite:{task}"
        self._task, (domain, name) = SUITE[task], suite.split_name(task)
        self._environment: Any = suite.load(domain, name, task_kwargs={"random": 0})
        self.scene = Scene.from_spec(_document(domain), source=self.name)
        self.timestep = float(self._environment.control_timestep())
        self.steps = steps or round(self._environment._step_limit)
        model = self.scene.model
        self.actions = model.nu
        self.observations = model.nq + sum(self._task.hinges) + model.nv

    def draw(self, seeds: Sequence[int]) -> Starts:
        """See `Problem.draw`: what dm_control's task draws from each seed."""
        task, physics = self._environment.task, self._environment.physics
        qpos, qvel = [], []
        for seed in seeds:
            task._random = np.random.RandomState(seed % 2**32)
            with physics.reset_context():
                task.initialize_episode(physics)
            qpos.append(physics.data.qpos.copy())
            qvel.append(physics.data.qvel.copy())
        nothing = np.zeros((len(qpos), 0))
        controls = np.zeros((len(qpos), self.actions))
        return Starts(np.array(qpos), np.array(qvel), controls, nothing, nothing)

    def begin(self, qpos: Tensor, qvel: Tensor, command: Tensor) -> Tensor:
        """[N, 2]: the mean of the reward that is learned from, and of dm_control's own."""
        return qpos.new_zeros((len(qpos), 2))

    def count(self, score: Tensor, qpos: Tensor, qvel: Tensor, control: Tensor) -> Tensor:
        """See `Problem.count`."""
        task = self._task
        rewards = [function(qpos, qvel, control) for function in (task.smooth, task.exact)]
        return score + torch.stack(rewards, 1) / self.steps

    def value(self, score: Tensor, qpos: Tensor) -> Tensor:
        """Mean reward [N, 1] that is learned from."""
        return score[:, :1]

    def measure(self, score: Tensor, qpos: Tensor) -> Tensor:
        """Mean of dm_control's own reward [N, 1]."""
        return score[:, 1:]

    def observe(self, moment: Moment) -> Tensor:
        """Positions (hinges as cosine and sine) and velocities."""
        parts = []
        for j, turns in enumerate(self._task.hinges):
            q = moment.qpos[:, j]
            parts += [q.cos(), q.sin()] if turns else [q]
        speeds = (moment.qvel / 5.0).clamp(-8.0, 8.0)
        return torch.cat([torch.stack(parts, 1), speeds], 1)

    def control(self, command: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """The action itself."""
        return action.clamp(-1.0, 1.0), command

    def success(self, starts: Starts, qpos: Floats, value: Floats) -> Mapping[str, Any]:
        """Whether the mean reward reaches the task's measure of it."""
        return {"return": value[:, 0] >= self._task.success}
