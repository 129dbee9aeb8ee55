"""Tasks of dm_control's suite whose rewards are written in tensors."""

from __future__ import annotations

import dataclasses
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

Reward = Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]
"""From qpos, qvel, control and goal [N, ...] to rewards [N]."""


class Task(NamedTuple):
    """A task's reward, and what a policy sees.

    Attributes:
      rewards: of the compiled model: dm_control's own reward, and what is learned from where that
        is flat almost everywhere; the same otherwise.
      hinges: which positions are seen as cosine and sine; those of None are not seen.
      success: a mean reward from which an episode has succeeded.
      goal: what each episode asks for, as dm_control has drawn it. place: writes it into a
        document.
      sees: more of the state and the goal, [N, `more`].
    """

    rewards: Callable[[mujoco.MjModel], tuple[Reward, Reward]]
    hinges: tuple[bool | None, ...]
    success: float
    goal: Callable[[Any], Sequence[float]] = lambda physics: ()
    place: Callable[[mujoco.MjSpec, Floats], None] = lambda spec, goal: None
    sees: Callable[[Tensor, Tensor], Tensor] | None = None
    more: int = 0


def _cartpole(model: mujoco.MjModel) -> tuple[Reward, Reward]:
    def reward(qpos: Tensor, qvel: Tensor, control: Tensor, goal: Tensor) -> Tensor:
        upright = (qpos[:, 1].cos() + 1) / 2
        centered = (1 + _gaussian(qpos[:, 0] / 2.0)) / 2
        small = (4 + (1 - control[:, 0].square()).clamp_min(0.0)) / 5
        slow = (1 + _gaussian(qvel[:, 1] / 5.0)) / 2
        return upright * small * slow * centered

    return reward, reward


def _pendulum(model: mujoco.MjModel) -> tuple[Reward, Reward]:
    def exact(qpos: Tensor, qvel: Tensor, control: Tensor, goal: Tensor) -> Tensor:
        return (qpos[:, 0].cos() >= math.cos(math.radians(8))).to(qpos.dtype)

    def smooth(qpos: Tensor, qvel: Tensor, control: Tensor, goal: Tensor) -> Tensor:
        upright = (qpos[:, 0].cos() + 1) / 2
        return upright * (1 + upright * _gaussian(qvel[:, 0] / 5.0)) / 2

    return exact, smooth


def _acrobot(model: mujoco.MjModel) -> tuple[Reward, Reward]:
    """Distance of the tip, two links of 1 m above the shoulder, from a ball of 0.2 m up there."""

    def away(qpos: Tensor) -> Tensor:
        first, second = qpos[:, 0], qpos[:, 0] + qpos[:, 1]
        across, below = first.sin() + second.sin(), 2 - first.cos() - second.cos()
        return _length(across, below)

    def exact(qpos: Tensor, qvel: Tensor, control: Tensor, goal: Tensor) -> Tensor:
        return _gaussian((away(qpos) - 0.2).clamp_min(0.0))

    def smooth(qpos: Tensor, qvel: Tensor, control: Tensor, goal: Tensor) -> Tensor:
        return (exact(qpos, qvel, control, goal) + 1 - away(qpos) / 4) / 2

    return exact, smooth


def _finger(qpos: Tensor) -> tuple[Tensor, Tensor]:
    """x and y of the reacher's finger, m."""
    first, second = qpos[:, 0], qpos[:, 0] + qpos[:, 1]
    return 0.12 * (first.cos() + second.cos()), 0.12 * (first.sin() + second.sin())


def _reacher(model: mujoco.MjModel) -> tuple[Reward, Reward]:
    """Whether the finger, of 1 cm, touches the target, of 5 cm."""

    def away(qpos: Tensor, goal: Tensor) -> Tensor:
        x, y = _finger(qpos)
        return _length(x - goal[:, 0], y - goal[:, 1])

    def exact(qpos: Tensor, qvel: Tensor, control: Tensor, goal: Tensor) -> Tensor:
        return (away(qpos, goal) <= 0.06).to(qpos.dtype)

    def smooth(qpos: Tensor, qvel: Tensor, control: Tensor, goal: Tensor) -> Tensor:
        return 1 / (1 + (away(qpos, goal) / 0.06).square())

    return exact, smooth


def _to_target(qpos: Tensor, goal: Tensor) -> Tensor:
    """[N, 2]: from the reacher's finger to its target."""
    return (goal - torch.stack(_finger(qpos), 1)) / 0.1


def _target(physics: Any) -> Sequence[float]:
    x, y, _ = physics.named.model.geom_pos["target"]
    return float(x), float(y)


def _place_target(spec: mujoco.MjSpec, goal: Floats) -> None:
    spec.geom("target").pos[:2] = goal


def _cheetah(model: mujoco.MjModel) -> tuple[Reward, Reward]:
    """The speed of its centre of mass, up to 10 m/s."""
    speed = _forward_speed(model)

    def smooth(qpos: Tensor, qvel: Tensor, control: Tensor, goal: Tensor) -> Tensor:
        return (speed(qpos, qvel) / 10.0).clamp_max(1.0)

    def exact(qpos: Tensor, qvel: Tensor, control: Tensor, goal: Tensor) -> Tensor:
        return smooth(qpos, qvel, control, goal).clamp_min(0.0)

    return exact, smooth


def _forward_speed(model: mujoco.MjModel) -> Callable[[Tensor, Tensor], Tensor]:
    """x velocity of the centre of mass of a planar tree: slides along x and z and a hinge about y
    at its root, one hinge about y at every other body."""
    # numbers of Python: torch's compiler takes those of an array for what it cannot know
    share = (model.body_mass / model.body_mass.sum()).tolist()
    place, centre = model.body_pos.tolist(), model.body_ipos.tolist()
    parents, dofs = model.body_parentid.tolist(), [2, *model.body_dofadr[2:].tolist()]

    def sideways(angle: Tensor, rate: Tensor, point: Sequence[float]) -> Tensor:
        """x velocity of a point of a body that turns about y."""
        return rate * (point[2] * angle.cos() - point[0] * angle.sin())

    def speed(qpos: Tensor, qvel: Tensor) -> Tensor:
        angle, rate, along = {}, {}, {}
        found = torch.zeros_like(qvel[:, 0])
        for body, dof in enumerate(dofs, start=1):
            before = parents[body]
            angle[body], rate[body], along[body] = qpos[:, dof], qvel[:, dof], qvel[:, 0]
            if before:
                turned = sideways(angle[before], rate[before], place[body])
                angle[body] = angle[body] + angle[before]
                rate[body] = rate[body] + rate[before]
                along[body] = along[before] + turned
            own = along[body] + sideways(angle[body], rate[body], centre[body])
            found = found + share[body] * own
        return found

    return speed


def _length(x: Tensor, y: Tensor) -> Tensor:
    """sqrt(x^2 + y^2), with a gradient at 0."""
    return (x.square() + y.square() + 1e-16).sqrt()


def _gaussian(x: Tensor) -> Tensor:
    """dm_control's `tolerance` with its default sigmoid and value at the margin, 0.1."""
    return (math.log(0.1) * x.square()).exp()


_CHEETAH = (None, False, *[True] + [False] * 6)
"""Where it is along its way is not seen, as in dm_control."""

SUITE: Mapping[str, Task] = {
    "cartpole-swingup": Task(_cartpole, (False, True), 0.6),
    "pendulum-swingup": Task(_pendulum, (True,), 0.6),
    "acrobot-swingup": Task(_acrobot, (True, True), 0.3),
    "reacher-easy": Task(
        _reacher, (True, True), 0.8, _target, _place_target, sees=_to_target, more=2
    ),
    "cheetah-run": Task(_cheetah, _CHEETAH, 0.5),
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
        self._domain, model = domain, self.scene.model
        self._exact, self._smooth = self._task.rewards(model)
        self.actions = model.nu
        seen = [1 + turns for turns in self._task.hinges if turns is not None]
        self.observations = sum(seen) + model.nv + self._task.more

    def draw(self, seeds: Sequence[int]) -> Starts:
        """See `Problem.draw`: what dm_control's task draws from each seed."""
        task, physics = self._environment.task, self._environment.physics
        qpos, qvel, goals = [], [], []
        for seed in seeds:
            task._random = np.random.RandomState(seed % 2**32)
            with physics.reset_context():
                task.initialize_episode(physics)
            qpos.append(physics.data.qpos.copy())
            qvel.append(physics.data.qvel.copy())
            goals.append(self._task.goal(physics))
        nothing = np.zeros((len(qpos), 0))
        controls = np.zeros((len(qpos), self.actions))
        goal = np.array(goals, np.float64).reshape(len(qpos), -1)
        return Starts(np.array(qpos), np.array(qvel), controls, goal, nothing)

    def trials(self, count: int, seed: int) -> tuple[Scene, Starts]:
        """See `Problem.trials`: with the goal of the first episode."""
        starts = self.draw(range(seed, seed + count))
        if not starts.command.shape[1]:
            return self.scene, starts
        spec = _document(self._domain)
        self._task.place(spec, starts.command[0])
        goal = np.tile(starts.command[:1], (count, 1))
        return Scene.from_spec(spec, source=self.name), dataclasses.replace(starts, command=goal)

    def begin(self, qpos: Tensor, qvel: Tensor, command: Tensor) -> Tensor:
        """[N, 2 + C]: the mean of the reward that is learned from, that of dm_control's own, and
        the goal."""
        return torch.cat([qpos.new_zeros((len(qpos), 2)), command.to(qpos)], 1)

    def count(self, score: Tensor, qpos: Tensor, qvel: Tensor, control: Tensor) -> Tensor:
        """See `Problem.count`."""
        goal = score[:, 2:]
        rewards = [f(qpos, qvel, control, goal) for f in (self._smooth, self._exact)]
        return torch.cat([score[:, :2] + torch.stack(rewards, 1) / self.steps, goal], 1)

    def value(self, score: Tensor, qpos: Tensor) -> Tensor:
        """Mean reward [N, 1] that is learned from."""
        return score[:, :1]

    def measure(self, score: Tensor, qpos: Tensor) -> Tensor:
        """Mean of dm_control's own reward [N, 1]."""
        return score[:, 1:2]

    def observe(self, moment: Moment) -> Tensor:
        """Positions (hinges as cosine and sine), velocities, and the way to the goal."""
        parts = []
        for j, turns in enumerate(self._task.hinges):
            if turns is None:
                continue
            q = moment.qpos[:, j]
            parts += [q.cos(), q.sin()] if turns else [q]
        speeds = (moment.qvel / 5.0).clamp(-8.0, 8.0)
        seen = [torch.stack(parts, 1), speeds]
        if self._task.sees is not None:
            seen.append(self._task.sees(moment.qpos, moment.command.to(moment.qpos)))
        return torch.cat(seen, 1)

    def control(self, command: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """The action itself."""
        return action.clamp(-1.0, 1.0), command

    def success(self, starts: Starts, qpos: Floats, value: Floats) -> Mapping[str, Any]:
        """Whether the mean reward reaches the task's measure of it."""
        return {"return": value[:, 0] >= self._task.success}
