"""Equation L_dyn: the losses over a T-step rollout, teacher-forced or autoregressive."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from orbisim_world_model.config import LossConfig, Stage
from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.entities import Entities, choose
from orbisim_world_model.losses import (
    Scales,
    encoding_loss,
    scaled_state_loss,
    state_loss,
    transition_loss,
)
from orbisim_world_model.network.coupling import token_mask
from orbisim_world_model.rotation import exponential, multiply, normalized
from orbisim_world_model.sampling import Batch


class Draws(NamedTuple):
    """The random numbers of a training step.

    Attributes:
      noise: [L, B, entries of the state] standard normal.
      chance: [L, B] uniform; ground truth is replaced where it is below the ratio.
    """

    noise: Tensor
    chance: Tensor


def autoregressive_ratio(stage: Stage, progress: float) -> float:
    """Share of ground truth that is replaced by predictions, 0.5 (1 - cos(pi progress)).

    Args:
      stage: of the training.
      progress: within the stage, 0 to 1.
    """
    if not stage.autoregressive:
        return 0.0
    if stage.full:
        return 1.0
    return 0.5 * (1.0 - math.cos(math.pi * min(max(progress, 0.0), 1.0)))


def dynamics_loss(
    model: Dynamics,
    batch: Batch,
    draws: Draws,
    ratio: Tensor,
    scales: Scales,
    config: LossConfig,
    noise: float,
    warm: int,
) -> tuple[Tensor, Tensor]:
    """Equation L_dyn, mean over steps and sequences, and the part of it that is L_dec.

    Args:
      ratio: [] share of ground truth replaced (see `autoregressive_ratio`).
      scales: units of errors and noise.
      noise: standard deviation on inputs, in these units.
      warm: how many steps see ground truth in any case.
    """
    length, size = batch.control.shape[:2]
    context, layout = batch.context, model.layout
    memory = model.initial_memory(size)
    tokens = None
    if context.mask is not None and model.config.kind == "objects":
        tokens = token_mask(context.mask, layout.has_robot)
    total = reconstruction = batch.control.new_zeros(())
    predicted: Entities | None = None
    for t in range(length):
        x = batch.states.at(t)
        if noise:
            x = model.completed(perturbed(x, draws.noise[t] * noise, scales))
        if predicted is not None and t >= warm:
            x = choose(draws.chance[t] < ratio, predicted, x)
        base = None if batch.base is None else batch.base.at(t)
        step = model(x, memory, batch.control[t], context, base=base)
        memory, predicted = step.memory, step.state
        target = batch.states.at(t + 1)
        if config.scaled:
            loss = scaled_state_loss(
                predicted, target, context.mask, layout, scales, config.beta
            ).mean()
        else:
            loss = state_loss(predicted, target, context.mask, layout).mean()
        reconstruction = reconstruction + loss
        total = total + loss + step.penalty
        if (config.alignment or config.consistency) and model.config.kind != "dreamer":
            z = model.encode(target, memory, batch.control[t], context)
            total = total + config.alignment * transition_loss(step.latent, z, tokens)
            total = total + config.consistency * encoding_loss(step.latent, z, tokens)
    return total / length, reconstruction / length


def noise_size(layout_joints: int, activations: int, objects: int) -> int:
    """Number of entries of a state that noise is added to."""
    return 2 * layout_joints + activations + 12 * objects


def perturbed(x: Entities, noise: Tensor, scales: Scales) -> Entities:
    """The state with noise [B, entries], in units of the scales; rotations stay rotations."""
    joints, count = x.q.shape[1], x.pos.shape[1]
    dq, dv, dact, rest = noise.split((joints, joints, x.act.shape[1], 12 * count), dim=1)
    x = x._replace(q=x.q + dq * scales.q, v=x.v + dv * scales.v, act=x.act + dact * scales.act)
    if not count:
        return x
    pos, turn, vel, ang = rest.unflatten(1, (count, 12)).split(3, dim=-1)
    return x._replace(
        pos=x.pos + pos * scales.objects[0],
        quat=normalized(multiply(exponential(turn * scales.objects[1]), x.quat)),
        vel=x.vel + vel * scales.objects[2],
        ang=x.ang + ang * scales.objects[3],
    )


@torch.no_grad()  # type: ignore[untyped-decorator]
def open_loop(model: Dynamics, batch: Batch, burn: int, start: Entities | None = None) -> Entities:
    """Predicted states [L - burn, B, ...] after `burn` steps that saw ground truth.

    Args:
      start: state at the end of the burn-in, where it is not the batch's.
    """
    size = batch.control.shape[1]
    memory = model.initial_memory(size)
    x = model.completed(batch.states.at(0))
    found = []
    for t in range(len(batch.control)):
        if t <= burn:
            x = model.completed(batch.states.at(t) if start is None or t < burn else start)
        base = None if batch.base is None else batch.base.at(t)
        step = model(x, memory, batch.control[t], batch.context, observe=t <= burn, base=base)
        memory, x = step.memory, step.state
        if t >= burn:
            found.append(x)
    return Entities(*(torch.stack(parts) for parts in zip(*found, strict=True)))
