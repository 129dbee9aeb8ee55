"""Trains a `Spread` on rollouts of a finished model, and calibrates it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.network.inputs import Inputs
from orbisim_world_model.pack import Pack
from orbisim_world_model.sampling import Windows, generator_of
from orbisim_world_model.schedule import Clock
from orbisim_world_model.spread import (
    FLOOR,
    FREEDOM,
    LEVEL,
    WIDTH,
    deviation,
    propagated,
    true_errors,
)
from orbisim_world_model.unroll import open_loop

_TOGETHER = 4096
"""Rollouts at once: a GPU takes as long for fewer, and more take memory."""


class Rollouts(NamedTuple):
    """Rollouts of a model beside the truth.

    Attributes:
      states: fields [L, B, ...], what the model saw at each step. control: [L, B, U].
      errors: [L, B, K, 2] after each step, in `spread.UNITS`.
      context: of each rollout. mask: [B, K].
    """

    states: Entities
    control: Tensor
    errors: Tensor
    context: Context
    mask: Tensor

    def at(self, chosen: Tensor) -> Rollouts:
        """Some of the rollouts."""
        c = self.context
        assert c.mask is not None
        return Rollouts(
            Entities(*(field[:, chosen] for field in self.states)),
            self.control[:, chosen],
            self.errors[:, chosen],
            Context(c.attributes[chosen], c.world[chosen], c.mask[chosen]),
            self.mask[chosen],
        )


@dataclasses.dataclass(frozen=True)
class SpreadRun:
    """How a spread is trained.

    Attributes:
      steps, batch: of training; rollouts in a batch. rate: of learning, at the start.
      limit: of training, s, if it comes before `steps`.
      finest: what errors are told apart from in training, in `spread.UNITS`: less than in
        intervals, since small errors show where large ones come from.
      windows: rollouts to train on. length: of each, control steps; as long as the longest episode
        if None. Where packs differ in it, longer rollouts are fewer by as much, in `windows` and in
        `batch`.
    """

    steps: int = 1500
    batch: int = 128
    rate: float = 3e-3
    windows: int = 6000
    length: int | None = None
    width: int = WIDTH
    seed: int = 0
    limit: float | None = None
    finest: float = 1e-3


def fit_spread(
    model: Dynamics, packs: Sequence[Pack], held: Sequence[Pack], run: SpreadRun
) -> dict[str, Any]:
    """Gives the model a spread, trained on some packs in turn and calibrated on others.

    Args:
      model: finished; on the packs' device.
      packs: rollouts start anywhere in their episodes. held: episodes that were not trained on.
      run: see `SpreadRun`.

    Returns:
      What the manifest keeps: `width`, the `factor`s by which the standard deviations of position
      and rotation become the half-widths of 90 % intervals, of `robot` and `objects`, and the
      `floor` of these deviations; and how many `steps` of training there were.
    """
    torch.manual_seed(run.seed)
    model.eval().requires_grad_(False)
    model.spread = None
    data = _groups(model, packs, run, run.windows, run.seed)
    model.with_spread(run.width).spread.to(packs[0].device)  # type: ignore[union-attr]
    assert model.spread is not None
    optimizer = torch.optim.Adam(model.spread.parameters(), lr=run.rate)
    shortest = min(len(group.control) for group in data)
    clock = Clock(run.steps, run.limit)
    while (progress := clock.progress) < 1.0:
        step = clock.done
        group = data[step % len(data)]
        length, count = group.control.shape[:2]
        size = max(1, run.batch * shortest // length)
        generator = generator_of(group.control.device, run.seed, step)
        chosen = torch.randint(count, (size,), generator=generator, device=group.control.device)
        for parameters in optimizer.param_groups:
            parameters["lr"] = run.rate * 0.5 * (1 + math.cos(math.pi * progress))
        part = group.at(chosen)
        loss = spread_loss(deviations(model, part, run.finest), part)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.spread.parameters(), 1.0)
        optimizer.step()
        clock.done += 1
    model.spread.requires_grad_(False)
    model.spread.eval()
    known = {"width": run.width, "level": LEVEL, "floor": FLOOR, "steps": clock.done}
    return {**known, "factor": calibrated(model, held, run)}


def _groups(
    model: Dynamics, packs: Sequence[Pack], run: SpreadRun, windows: int, seed: int
) -> list[Rollouts]:
    """Rollouts of each pack; the longer, the fewer."""
    longest = [int(pack.length.max()) for pack in packs]
    lengths = [min(run.length or most, most) for most in longest]
    return [
        rollouts(model, pack, length, max(1, windows * min(lengths) // length), seed)
        for pack, length in zip(packs, lengths, strict=True)
    ]


def rollouts(model: Dynamics, pack: Pack, length: int, count: int, seed: int) -> Rollouts:
    """Open-loop rollouts from states drawn from the pack."""
    windows = Windows(pack, length, model.config)
    generator = generator_of(pack.device, seed, 0)
    number = torch.randint(windows.count, (count,), generator=generator, device=pack.device)
    found = []
    for part in number.split(_TOGETHER):
        batch = windows.batch(*windows.locate(part))
        predicted = open_loop(model, batch, 0)
        truth = Entities(*(field[1:] for field in batch.states))
        start = Entities(*(field[None] for field in model.completed(batch.states.at(0))))
        seen = Entities(*(torch.cat([a, b[:-1]]) for a, b in zip(start, predicted, strict=True)))
        errors = true_errors(predicted, truth, model.layout)
        mask = batch.context.mask
        assert mask is not None
        robot = torch.ones_like(mask[:, :1]) if model.layout.has_robot else mask[:, :0]
        tokens = torch.cat([robot, mask], dim=1)
        found.append(Rollouts(seen, batch.control, errors, batch.context, tokens))
    return _joined(found)


def deviations(model: Dynamics, data: Rollouts, floor: float = FLOOR) -> Tensor:
    """Standard deviations [L, B, K, 2] that the model's spread predicts, in `spread.UNITS`."""
    assert model.spread is not None
    length, size = data.control.shape[:2]
    flat = Entities(*(field.flatten(0, 1) for field in data.states))
    attributes, world = (
        part.expand(length, *part.shape).flatten(0, 1)
        for part in (data.context.attributes, data.context.world)
    )
    context = Context(attributes, world, None)
    inputs: Inputs = model.inputs(flat, data.control.flatten(0, 1), context)
    gain, noise = (part.unflatten(0, (length, size)) for part in model.spread.rates(inputs))
    variance, found = torch.zeros_like(noise[0]), []
    for t in range(length):
        variance = propagated(gain[t], noise[t], variance)
        found.append(variance)
    return deviation(torch.stack(found), floor)


def spread_loss(sizes: Tensor, data: Rollouts) -> Tensor:
    """Negative log likelihood of the errors' sizes under half a Student's t."""
    ratio = (data.errors / sizes).square() / FREEDOM
    each = sizes.log() + 0.5 * (FREEDOM + 1.0) * torch.log1p(ratio)
    weight = data.mask[None, ..., None].expand_as(each)
    return (each * weight).sum() / weight.sum()


@torch.no_grad()  # type: ignore[untyped-decorator]
def calibrated(model: Dynamics, held: Sequence[Pack], run: SpreadRun) -> dict[str, list[float]]:
    """Factors of the standard deviations that cover `LEVEL` of the errors of held-out rollouts.

    Of the second half of each rollout, since at first nothing has happened and any interval will
    do; of robots and of objects apart, since a robot is hardly ever wrong.
    """
    data = _groups(model, held, run, 1024, run.seed + 1)
    return factors([(deviations(model, d), d) for d in data], int(model.layout.has_robot))


def factors(known: Sequence[tuple[Tensor, Rollouts]], robots: int) -> dict[str, list[float]]:
    """See `calibrated`, from deviations and rollouts; `robots` is how many entities are robots."""
    found = {}
    for kind, part in (("robot", slice(0, robots)), ("objects", slice(robots, None))):
        rows = torch.cat([_ratios(sizes, data, part) for sizes, data in known])
        level = [_quantile(rows[:, i], LEVEL) if len(rows) else torch.ones(()) for i in range(2)]
        found[kind] = [max(float(value), 1e-6) for value in level]
    return found


def _ratios(sizes: Tensor, data: Rollouts, part: slice) -> Tensor:
    """[n, 2]: errors over deviations of some entities, over the second half of each rollout."""
    late = len(sizes) // 2
    ratio = (data.errors / sizes)[late:, :, part]
    return ratio[data.mask[:, part].expand(len(ratio), -1, -1) > 0]


def _quantile(values: Tensor, level: float) -> Tensor:
    """`torch.quantile` takes at most 16 million numbers."""
    return values.kthvalue(max(1, round(level * values.numel()))).values


def _joined(parts: list[Rollouts]) -> Rollouts:
    states = Entities(*(torch.cat(f, 1) for f in zip(*(p.states for p in parts), strict=True)))
    context = Context(*(torch.cat(f) for f in zip(*(p.context[:3] for p in parts), strict=True)))
    return Rollouts(
        states,
        torch.cat([p.control for p in parts], 1),
        torch.cat([p.errors for p in parts], 1),
        context,
        torch.cat([p.mask for p in parts]),
    )
