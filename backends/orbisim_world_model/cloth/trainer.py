"""`ClothTrainer`: steps of gradient descent on sequences of falls."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from orbisim_world_model.cloth.config import ClothConfig, ClothStage
from orbisim_world_model.cloth.data import Falls
from orbisim_world_model.cloth.dynamics import ClothDynamics, free_fall
from orbisim_world_model.cloth.mesh import Cloth
from orbisim_world_model.cloth.shape import ShapeNetwork
from orbisim_world_model.optimizer import FlatAdamW

_ROUND = 0.1
"""Of a unit: errors below count quadratically, above linearly; folds go either way, and those
that went the other way must not decide."""
_DECAY = 1e-4  # as of the other models (`config.TrainConfig`)
_FEW = 4000
"""States that units and components are taken from; they span 675 numbers at most."""


class ClothTrainer:
    """A model, its data and its optimiser.

    Args:
      falls: the data. config: of model and training. seed: of weights and batches.
      model: to go on with.
    """

    def __init__(
        self, falls: Falls, config: ClothConfig, seed: int, model: ClothDynamics | None = None
    ) -> None:
        self.falls, self.config, self.seed = falls, config, seed
        torch.manual_seed(seed)
        fresh = model is None
        self.model = model or ClothDynamics(config.model, falls.mesh)
        self.model.mesh = falls.mesh
        self.model.to(falls.x.pos.device).train()
        if fresh:
            self._take_units()
        self.optimizer = FlatAdamW(self.model, _DECAY, config.train.clip)
        self.done = 0

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def _take_units(self) -> None:
        before, after = _pairs(self.falls)
        fallen = free_fall(self.falls.mesh, before)
        gaps = [(a - f).square().sum(-1).mean().sqrt() for a, f in zip(after, fallen, strict=True)]
        self.model.normalise(torch.stack(gaps))
        if isinstance(self.model.network, ShapeNetwork):
            self.model.network.fit(self.falls.mesh, before, after, fallen)

    def step(self, progress: float) -> float:
        """One update; the loss. `progress` is the share of the training that is done."""
        train, stage = self.config.train, self._stage(progress)
        rate = train.final_rate + 0.5 * (train.rate - train.final_rate) * (
            1 + math.cos(math.pi * min(progress, 1.0))
        )
        self.optimizer.rate.fill_(rate)
        self.optimizer.zero_grad()
        loss = self._loss(stage)
        loss.backward()
        self.optimizer.step()
        self.done += 1
        return float(loss.detach())

    def _stage(self, progress: float) -> ClothStage:
        reached = 0.0
        for stage in self.config.train.stages:
            reached += stage.fraction
            if progress < reached:
                return stage
        return self.config.train.stages[-1]

    def _loss(self, stage: ClothStage) -> Tensor:
        """Distance of vertices from the truth in units of a step, over a sequence."""
        falls, train = self.falls, self.config.train
        draw = torch.Generator().manual_seed(self.seed * 1_000_003 + self.done)
        length = min(stage.length, falls.steps)
        episode = torch.randint(falls.episodes, (stage.batch,), generator=draw)
        start = torch.randint(falls.steps - length + 1, (stage.batch,), generator=draw)
        device = falls.x.pos.device
        turn = _turns(draw, stage.batch).to(device)
        x = self.model.told(Cloth(*(field[episode, start] for field in falls.x)))
        scale = self.model.scale
        x = Cloth(*(
            field + train.noise * scale[k] * torch.randn(field.shape, generator=draw).to(device)
            / 3**0.5 for k, field in enumerate(x)
        ))  # fmt: skip
        solids = falls.solids.at(episode.to(device))
        losses = []
        for t in range(1, length + 1):
            x = self.model(x, solids, turn)
            truth = self.model.told(Cloth(*(field[episode, start + t] for field in falls.x)))
            astray, hasty = (x.pos - truth.pos) / scale[0], (x.vel - truth.vel) / scale[1]
            losses.append(_length(astray) / t + train.velocity * _length(hasty))
        return torch.stack(losses).mean()


def _length(vectors: Tensor) -> Tensor:
    """Mean length of vectors [..., 3], rounded where it is small."""
    return ((vectors.square().sum(-1) + _ROUND**2).sqrt() - _ROUND).mean()


def _turns(draw: torch.Generator, count: int) -> Tensor:
    """[count, 3, 3]: frames turned about the vertical, half of them mirrored: physics is the same
    in all of them."""
    angle = 2 * math.pi * torch.rand(count, generator=draw)
    mirror = torch.where(torch.rand(count, generator=draw) < 0.5, -1.0, 1.0)
    c, s, zero, one = angle.cos(), angle.sin(), torch.zeros(count), torch.ones(count)
    rows = [c, -s * mirror, zero, s, c * mirror, zero, zero, zero, one]
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def _pairs(falls: Falls) -> tuple[Cloth, Cloth]:
    """States and those a step later, [at most _FEW, V, 3], evenly from all episodes."""
    every = max(1, falls.episodes * falls.steps // _FEW)
    before = Cloth(*(field[:, :-1].flatten(0, 1)[::every] for field in falls.x))
    after = Cloth(*(field[:, 1:].flatten(0, 1)[::every] for field in falls.x))
    return before, after
