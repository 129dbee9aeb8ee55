"""`Trainer`: one training run, resumable to the exact step."""

from __future__ import annotations

import dataclasses
import time
import warnings
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from orbisim_world_model import parallel
from orbisim_world_model.compiling import CompiledMoment
from orbisim_world_model.config import Config, Stage
from orbisim_world_model.dynamics import Dynamics, Transitions, fit_together
from orbisim_world_model.graphs import Graphed
from orbisim_world_model.losses import Scales, measure_scales
from orbisim_world_model.optimizer import FlatAdamW
from orbisim_world_model.pack import Pack
from orbisim_world_model.sampling import Batch, Windows, generator_of
from orbisim_world_model.schedule import Clock, learning_rate, stage_at
from orbisim_world_model.stepper import cause
from orbisim_world_model.unroll import (
    Draws,
    Objective,
    autoregressive_ratio,
    dynamics_loss,
    moment_loss,
    noise_size,
)


@dataclasses.dataclass(eq=False)
class Part:
    """The data of one robot, and the model that shares all but the robot's parts with the others.

    Attributes:
      scales: units of errors and noise.
      count: control steps of the data.
      windows: sequences of the current stage.
    """

    pack: Pack
    model: Dynamics
    scales: Scales
    count: int
    windows: Windows | None = None


class Trainer:
    """Trains one model on one pack, or the models of several robots on a pack each.

    Args:
      packs: training episodes, on the device to train on.
      config: of model and training.
      clock: budgets.
      seed: of initial weights, batches and noise.
      models: to go on from, with their scales; new ones if None.
      graph: whether to run a step as a CUDA graph, where there is a GPU.
      compiled: whether torch compiles the losses, once for each batch size; half a minute or more.
    """

    def __init__(
        self,
        packs: Pack | Sequence[Pack],
        config: Config,
        clock: Clock,
        *,
        seed: int = 0,
        models: Sequence[Dynamics] | None = None,
        graph: bool = True,
        compiled: bool = False,
    ) -> None:
        packs = [packs] if isinstance(packs, Pack) else list(packs)
        self.config, self.clock, self.seed = config, clock, seed
        self.device = torch.device(packs[0].device)
        on_gpu = self.device.type == "cuda"
        self.graph = graph and on_gpu
        if on_gpu:
            torch.backends.cuda.matmul.allow_tf32 = config.train.precision != "fp32"
        models = models or new_models(packs, config, seed)
        for model in models:
            model.to(self.device).train()
        for number, model in enumerate(models):
            model.share(models[:number])
        self.parts = [
            Part(pack, model, _scales(pack), int(pack.length.sum()))
            for pack, model in zip(packs, models, strict=True)
        ]
        everything = torch.nn.ModuleList(models)
        self.optimizer = FlatAdamW(everything, config.train.decay, config.train.clip)
        self.ratio = torch.zeros((), device=self.device)
        self._each: Any = CompiledMoment() if compiled else moment_loss
        self._stage: int | None = None
        self._losses: list[Tensor] = []

    @property
    def models(self) -> list[Dynamics]:
        """One for each robot."""
        return [part.model for part in self.parts]

    @property
    def precision(self) -> str:
        """Of the matrix products that it computes; only a GPU has TF32."""
        return self.config.train.precision if self.device.type == "cuda" else "fp32"

    def step(self) -> None:
        """One step of training; the losses are collected for `losses`."""
        config, clock = self.config.train, self.clock
        progress = parallel.agreed(clock.progress, self.device)
        number, within = stage_at(config, progress)
        if number != self._stage:
            self._prepare(number)
        stage = config.stages[number]
        self.ratio.fill_(autoregressive_ratio(stage, within))
        self.optimizer.rate.fill_(learning_rate(config, progress))
        self._load(stage)
        if self.config.model.kind == "dreamer":  # draws its latents from torch's own generator
            torch.manual_seed(self.seed * 1_000_003 + clock.done)
        self._losses.append(self._run().clone())
        clock.done += 1
        if clock.done % 16 == 0 and self.graph:
            torch.cuda.synchronize()  # so that the clock tells how far the GPU is

    def losses(self) -> dict[str, float]:
        """Mean losses of the steps since the last call whose losses were finite; NaN if none was.

        What is not finite changes nothing in the model (see `FlatAdamW`), and is counted.
        """
        if not self._losses:
            return {}
        rows = torch.stack(self._losses)
        total, state = rows[rows.isfinite().all(1)].mean(0).tolist()
        self._losses = []
        return {"loss": total, "state_loss": state, "skipped": float(self.optimizer.skipped)}

    # -- a step --------------------------------------------------------------------------------

    def _prepare(self, number: int) -> None:
        """Buffers and graph of a stage."""
        self._stage = number
        stage = self.config.train.stages[number]
        self._run: Any = None  # frees the graph of the stage before
        for part in self.parts:
            part.windows = Windows(part.pack, stage.length, self.config.model)
        self._buffers: list[tuple[Batch, Draws]] | None = None
        self._load(stage)
        self._compile()
        if parallel.size() > 1:
            forward = Graphed(self._forward_backward, lambda: None, self.graph)

            def run() -> Tensor:
                losses = forward()
                parallel.average(self.optimizer.gradient)
                self.optimizer.step()
                return losses

            self._run = run
            return
        saved = {name: tensor.clone() for name, tensor in self.optimizer.state().items()}

        def whole() -> Tensor:
            losses = self._forward_backward()
            self.optimizer.step()
            return losses

        self._run = Graphed(whole, lambda: self.optimizer.restore(saved), self.graph)

    def _compile(self) -> None:
        """Has the losses compiled for this stage; goes on without where that fails."""
        if self._each is moment_loss:
            return
        began = time.monotonic()
        try:
            self._forward_backward()
        except Exception as error:  # compilers fail in many ways; the losses themselves do not
            self._each = moment_loss
            warnings.warn(f"training not compiled, it is slower: {cause(error)}", stacklevel=2)
        self.clock.skip(time.monotonic() - began)

    def _load(self, stage: Stage) -> None:
        """Fills the buffers with the batch and the random numbers of this step."""
        generator = generator_of(self.device, self.seed, self.clock.done)
        sizes = self._shares(stage.batch)
        fresh = [
            self._drawn(part, stage.length, size, generator)
            for part, size in zip(self.parts, sizes, strict=True)
        ]
        if self._buffers is None or not self.graph:
            self._buffers = fresh
        else:
            _copy(self._buffers, fresh)

    def _shares(self, batch: int) -> list[int]:
        """Sequences of each part: as many of each robot; of limbs, by how many there are, whatever
        their length, so that a stage with the same batch has the same shapes."""
        if not self.config.model.articulated:
            return [-(-batch // len(self.parts))] * len(self.parts)
        counts = [part.count for part in self.parts]
        return [max(1, round(batch * count / sum(counts))) for count in counts]

    def _drawn(
        self, part: Part, length: int, size: int, generator: torch.Generator
    ) -> tuple[Batch, Draws]:
        """This process' share of so many sequences."""
        assert part.windows is not None
        row, episode = part.windows.draw(size, generator)
        layout, shape = part.pack.layout, (length, size)
        entries = noise_size(len(layout.joints), layout.na, len(layout.objects))
        noise = torch.randn((*shape, entries), generator=generator, device=self.device)
        chance = torch.rand(shape, generator=generator, device=self.device)
        mine = parallel.shares(size)
        batch = part.windows.batch(row[mine], episode[mine])
        return batch, Draws(noise[:, mine], chance[:, mine])

    def _forward_backward(self) -> Tensor:
        assert self._buffers is not None and self._stage is not None
        self.optimizer.zero_grad()
        config, stage = self.config, self.config.train.stages[self._stage]
        losses = []
        sizes = self._shares(stage.batch)
        for part, size, (batch, draws) in zip(self.parts, sizes, self._buffers, strict=True):
            objective = Objective(part.model, part.scales, config.loss, config.train.noise)
            total, state = dynamics_loss(
                objective, batch, draws, self.ratio, stage.warm, self._each, stage.reach
            )
            (total * (size / sum(sizes))).backward()
            losses.append(torch.stack([total.detach(), state.detach()]))
        return torch.stack(losses).mean(0)


_FEW = 20_000
"""Transitions for the scales of limbs, whose Jacobians take some kilobytes a limb."""


def new_model(pack: Pack, config: Config, seed: int) -> Dynamics:
    """A model with fresh weights and the scales of the pack."""
    return new_models([pack], config, seed)[0]


def new_models(packs: Sequence[Pack], config: Config, seed: int) -> list[Dynamics]:
    """A model for each robot's pack, sharing all that is not the robot's."""
    models: list[Dynamics] = []
    samples: list[Transitions] = []
    for number, pack in enumerate(packs):
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed + 1_000_003 * number)
            model = Dynamics(pack.layout, config.model).build(pack.controls(config.model).shape[1])
        model.to(pack.device)
        model.share(models)
        models.append(model)
        most = _FEW if pack.layout.articulated else 200_000
        row, episode = pack.transitions(most // len(packs))
        base = pack.predictions(row) if config.model.baseline != "none" else None
        control = pack.controls(config.model)[row]
        context = pack.context(episode)
        samples.append(Transitions(pack.states(row), pack.states(row + 1), control, context, base))
    fit_together(models, samples)
    return models


def _scales(pack: Pack) -> Scales:
    row, episode = pack.transitions()
    x, after = pack.states(row), pack.states(row + 1)
    return measure_scales(x, after, pack.context(episode), pack.layout)


def _copy(into: Any, values: Any) -> None:
    """Copies every tensor of nested tuples in place."""
    for target, value in zip(into, values, strict=True):
        if isinstance(target, Tensor):
            target.copy_(value, non_blocking=True)
        elif target is not None:
            _copy(target, value)
