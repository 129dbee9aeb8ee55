"""Episodes of a policy in a step with gradients: equation of section 3.5."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from orbisim_world_model.entities import Context, Entities
from torch import Tensor

from orbisim_policies.learned import DifferentiableWorlds, Pool
from orbisim_policies.network import Policy
from orbisim_policies.problem import Moment, Problem

Acted = Callable[["Running", Tensor], "tuple[Running, Tensor]"]
"""One control step from noise on the actions; also gives what the policy saw."""


class Running(NamedTuple):
    """Worlds in the middle of their episodes.

    Attributes:
      x: the states. command: [N, C]. score: [N, S]. done: [N] steps of the episode so far.
      params: [N, P]. attributes, settings: descriptors.
    """

    x: Entities
    command: Tensor
    score: Tensor
    done: Tensor
    params: Tensor
    attributes: Tensor
    settings: Tensor

    def detach(self) -> Running:
        """Without gradients."""
        fields = [field.detach() for field in self[1:]]
        return Running(self.x.detach(), *fields)


def began(worlds: DifferentiableWorlds, starts: Pool) -> Running:
    """Episodes before their first step."""
    x, context = worlds.begin(starts)
    score = worlds.problem.begin(*worlds.coordinates(x), starts.command)
    done = torch.zeros(len(score), device=score.device)
    return Running(x, starts.command, score, done, starts.params, context.attributes, context.world)


def observation(worlds: DifferentiableWorlds, now: Running) -> Tensor:
    """What the policy sees, [N, F]."""
    qpos, qvel = worlds.coordinates(now.x)
    time = now.done / worlds.problem.steps
    moment = Moment(qpos, qvel, now.command, now.params, now.score, time)
    return torch.nan_to_num(worlds.problem.observe(moment), 0.0, 0.0, 0.0)


def advanced(worlds: DifferentiableWorlds, now: Running, action: Tensor, limit: float) -> Running:
    """One control step of all worlds.

    Args:
      worlds: the step. now: before it. action: [N, A].
      limit: largest norm of the gradient that a world hands back to the step before; 0 for none.
    """
    problem: Problem = worlds.problem
    x = _Limit.apply(limit, *now.x)
    (action,) = _Limit.apply(limit, action)
    control, command = problem.control(now.command, action)
    after = worlds.step(Entities(*x), control, Context(now.attributes, now.settings, None))
    qpos, qvel = worlds.coordinates(after)
    score = problem.count(now.score, qpos, qvel, control)
    return now._replace(x=after, command=command, score=score, done=now.done + 1)


def worth(worlds: DifferentiableWorlds, now: Running) -> Tensor:
    """[N, parts]: the value of the episode if it ends here."""
    return worlds.problem.value(now.score, worlds.coordinates(now.x)[0])


def acted(
    worlds: DifferentiableWorlds, policy: Policy, now: Running, noise: Tensor, limit: float
) -> tuple[Running, Tensor]:
    """One control step of a policy, and what it saw before."""
    view = observation(worlds, now)
    return advanced(worlds, now, policy(view, noise), limit), view


def compiled(worlds: DifferentiableWorlds, policy: Policy, limit: float) -> Acted:
    """`acted` compiled by torch for the number of worlds that it is called with.

    From tensors to tensors, as `orbisim_world_model.stepper.compiled_step`.
    """
    count = len(Entities._fields)

    def flat(noise: Tensor, *given: Tensor) -> tuple[Tensor, ...]:
        now = Running(Entities(*given[:count]), *given[count:])
        after, view = acted(worlds, policy, now, noise, limit)
        return (*after.x, after.command, after.score, after.done, view)

    fast = torch.compile(flat, dynamic=False, fullgraph=True)

    def step(now: Running, noise: Tensor) -> tuple[Running, Tensor]:
        x = [field if field.requires_grad else field.clone().requires_grad_() for field in now.x]
        *found, view = fast(noise, *x, *now[1:])
        after = now._replace(
            x=Entities(*found[:count]),
            command=found[count],
            score=found[count + 1],
            done=found[count + 2],
        )
        return after, view

    return step


@torch.no_grad()  # type: ignore[untyped-decorator]
def play(worlds: DifferentiableWorlds, policy: Any, starts: Pool) -> Running:
    """Whole episodes without noise and without gradients."""
    now = began(worlds, starts)
    act = policy.begin(len(now.done))
    for _ in range(worlds.problem.steps):
        now = advanced(worlds, now, act(observation(worlds, now)), 0.0)
    return now


class _Limit(torch.autograd.Function):
    """The identity; its gradient is shortened, world by world, to a largest norm.

    A world whose gradient is not finite hands none back.
    """

    @staticmethod
    def forward(ctx: Any, limit: float, *fields: Tensor) -> tuple[Tensor, ...]:
        ctx.limit = limit
        return tuple(field.view_as(field) for field in fields)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Any, ...]:
        squares = [g.square().flatten(1).sum(1) for g in gradients]
        norm = torch.stack(squares).sum(0).sqrt()
        limit = ctx.limit or math.inf
        scale = torch.nan_to_num((limit / (norm + 1e-12)).clamp(max=1.0), 0.0)
        scaled = [
            torch.nan_to_num(g, 0.0, 0.0, 0.0) * scale.reshape(-1, *([1] * (g.dim() - 1)))
            for g in gradients
        ]
        return (None, *scaled)
