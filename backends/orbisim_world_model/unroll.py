"""Equation L_dyn: the losses over a T-step rollout, teacher-forced or autoregressive."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from orbisim_world_model.config import LossConfig, Stage
from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.entities import Context, Entities, choose
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


class Moment(NamedTuple):
    """One step of a rollout.

    Attributes:
      truth, target: the true states before and after it.
      predicted: the prediction for `truth`, or None at the start.
      memory, control, base: as `Dynamics.forward` takes them.
      noise, chance: of this step (see `Draws`).
      ratio: [] share of ground truth that is replaced by `predicted`.
    """

    truth: Entities
    target: Entities
    predicted: Entities | None
    memory: Tensor
    control: Tensor
    base: Entities | None
    noise: Tensor
    chance: Tensor
    ratio: Tensor


class MomentLoss(NamedTuple):
    """What a step predicts, its loss [], and the part of it that is L_dec."""

    state: Entities
    memory: Tensor
    loss: Tensor
    reconstruction: Tensor


class Objective(NamedTuple):
    """What does not change from step to step.

    Attributes:
      model: to be trained.
      scales: units of errors and noise.
      config: weights of the losses.
      noise: standard deviation on inputs, in these units.
    """

    model: Dynamics
    scales: Scales
    config: LossConfig
    noise: float


def moment_loss(objective: Objective, moment: Moment, context: Context) -> MomentLoss:
    """The losses of one step."""
    model, scales, config, noise = objective
    layout, x = model.layout, moment.truth
    if noise:
        x = model.completed(perturbed(x, moment.noise * noise, scales, _own_units(model, context)))
    if moment.predicted is not None:
        x = choose(moment.chance < moment.ratio, moment.predicted, x)
    step = model(x, moment.memory, moment.control, context, base=moment.base)
    mask, target = context.mask, moment.target
    assert mask is not None
    if config.scaled:
        units = (scales, config.beta, model.config.extended)
        state = scaled_state_loss(step.state, target, context, layout, *units).mean()
    else:
        state = state_loss(step.state, target, mask, layout).mean()
    total = state + step.penalty
    if (config.alignment or config.consistency) and model.config.kind != "dreamer":
        objects = model.config.kind == "objects"
        tokens = token_mask(mask, layout.robot_token, context.part_mask) if objects else None
        z = model.encode(target, step.memory, moment.control, context)
        total = total + config.alignment * transition_loss(step.latent, z, tokens)
        total = total + config.consistency * encoding_loss(step.latent, z, tokens)
    return MomentLoss(step.state, step.memory, total, state)


def dynamics_loss(
    objective: Objective,
    batch: Batch,
    draws: Draws,
    ratio: Tensor,
    warm: int,
    each: Callable[[Objective, Moment, Context], MomentLoss] = moment_loss,
    reach: int = 0,
) -> tuple[Tensor, Tensor]:
    """Equation L_dyn, mean over steps and sequences, and the part of it that is L_dec.

    Args:
      ratio: [] share of ground truth replaced (see `autoregressive_ratio`).
      warm: how many steps see ground truth in any case.
      each: `moment_loss`, or the same compiled.
      reach: see `Stage`.
    """
    length, size = batch.control.shape[:2]
    memory = objective.model.initial_memory(size)
    total = reconstruction = batch.control.new_zeros(())
    predicted: Entities | None = None
    for t in range(length):
        moment = Moment(
            batch.states.at(t),
            batch.states.at(t + 1),
            predicted if t >= warm else None,
            memory,
            batch.control[t],
            None if batch.base is None else batch.base.at(t),
            draws.noise[t],
            draws.chance[t],
            ratio,
        )
        found = each(objective, moment, batch.context)
        memory, predicted = found.memory, found.state
        if reach and (t + 1) % reach == 0:
            memory, predicted = memory.detach(), predicted.detach()
        total, reconstruction = total + found.loss, reconstruction + found.reconstruction
    return total / length, reconstruction / length


def noise_size(layout_joints: int, activations: int, objects: int) -> int:
    """Number of entries of a state that noise is added to."""
    return 2 * layout_joints + activations + 12 * objects


def _own_units(model: Dynamics, context: Context) -> Tensor | None:
    limbs = model.features.limbs
    return None if limbs is None else limbs.units(context)


def perturbed(x: Entities, noise: Tensor, scales: Scales, units: Tensor | None = None) -> Entities:
    """The state with noise [B, entries], in units of the scales; rotations stay rotations.

    Args:
      units: [B, J, 2] of positions and velocities of joints, where worlds differ in them.
    """
    joints, count = x.q.shape[1], x.pos.shape[1]
    dq, dv, dact, rest = noise.split((joints, joints, x.act.shape[1], 12 * count), dim=1)
    q, v = (scales.q, scales.v) if units is None else units.unbind(-1)
    x = x._replace(q=x.q + dq * q, v=x.v + dv * v, act=x.act + dact * scales.act)
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
