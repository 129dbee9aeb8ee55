"""`Trainer`: one training run, resumable to the exact step."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from orbisim_world_model import parallel
from orbisim_world_model.config import Config, Stage
from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.graphs import Graphed
from orbisim_world_model.losses import measure_scales
from orbisim_world_model.optimizer import FlatAdamW
from orbisim_world_model.pack import Pack
from orbisim_world_model.sampling import Batch, Windows, generator_of
from orbisim_world_model.schedule import Clock, learning_rate, stage_at
from orbisim_world_model.unroll import Draws, autoregressive_ratio, dynamics_loss, noise_size

_PRECISION = {"bf16": torch.bfloat16}


class Trainer:
    """Trains one model on one pack.

    Args:
      pack: training episodes, on the device to train on.
      config: of model and training.
      clock: budgets.
      seed: of initial weights, batches and noise.
      model: to go on from, with its scales; a new one if None.
      graph: whether to run a step as a CUDA graph, where there is a GPU.
    """

    def __init__(
        self,
        pack: Pack,
        config: Config,
        clock: Clock,
        *,
        seed: int = 0,
        model: Dynamics | None = None,
        graph: bool = True,
    ) -> None:
        self.pack, self.config, self.clock, self.seed = pack, config, clock, seed
        device = torch.device(pack.device)
        on_gpu = device.type == "cuda"
        self.graph = graph and on_gpu
        if on_gpu and config.train.precision != "fp32":
            torch.backends.cuda.matmul.allow_tf32 = True
        precision = _PRECISION.get(config.train.precision) if on_gpu else None
        self.model = model or new_model(pack, config, seed)
        self.model.precision = precision
        self.model.to(device).train()
        self.scales = _scales(self.model, pack)
        self.optimizer = FlatAdamW(self.model, config.train.decay, config.train.clip)
        self.ratio = torch.zeros((), device=device)
        self._stage: int | None = None
        self._losses: list[Tensor] = []

    def step(self) -> None:
        """One step of training; the losses are collected for `losses`."""
        config, clock = self.config.train, self.clock
        progress = parallel.agreed(clock.progress, self.pack.device)
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
        """Mean losses since the last call."""
        if not self._losses:
            return {}
        total, state = torch.stack(self._losses).mean(0).tolist()
        self._losses = []
        return {"loss": total, "state_loss": state, "skipped": float(self.optimizer.skipped)}

    # -- a step --------------------------------------------------------------------------------

    def _prepare(self, number: int) -> None:
        """Buffers and graph of a stage."""
        self._stage = number
        stage = self.config.train.stages[number]
        self._run: Any = None  # frees the graph of the stage before
        self.windows = Windows(self.pack, stage.length, self.config.model)
        self.share = parallel.shares(stage.batch)
        self._buffers: tuple[Batch, Draws] | None = None
        self._load(stage)
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

    def _load(self, stage: Stage) -> None:
        """Fills the buffers with the batch and the random numbers of this step."""
        generator = generator_of(self.pack.device, self.seed, self.clock.done)
        row, episode = self.windows.draw(stage.batch, generator)
        layout = self.pack.layout
        size = noise_size(len(layout.joints), layout.na, len(layout.objects))
        shape = (stage.length, stage.batch)
        device = self.pack.device
        noise = torch.randn((*shape, size), generator=generator, device=device)
        chance = torch.rand(shape, generator=generator, device=device)
        mine = self.share
        batch = self.windows.batch(row[mine], episode[mine])
        draws = Draws(noise[:, mine], chance[:, mine])
        if self._buffers is None or not self.graph:
            self._buffers = batch, draws
        else:
            _copy(self._buffers, (batch, draws))

    def _forward_backward(self) -> Tensor:
        assert self._buffers is not None and self._stage is not None
        batch, draws = self._buffers
        self.optimizer.zero_grad()
        config, stage = self.config, self.config.train.stages[self._stage]
        total, state = dynamics_loss(
            self.model,
            batch,
            draws,
            self.ratio,
            self.scales,
            config.loss,
            config.train.noise,
            stage.warm,
        )
        total.backward()
        return torch.stack([total.detach(), state.detach()])


def new_model(pack: Pack, config: Config, seed: int) -> Dynamics:
    """A model with fresh weights and the scales of the pack."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        model = Dynamics(pack.layout, config.model).build(pack.controls(config.model).shape[1])
    model.to(pack.device)
    row, episode = pack.transitions()
    base = pack.predictions(row) if config.model.baseline != "none" else None
    control = pack.controls(config.model)[row]
    model.fit(pack.states(row), pack.states(row + 1), control, pack.context(episode), base)
    return model


def _scales(model: Dynamics, pack: Pack) -> Any:
    row, episode = pack.transitions()
    x, after = pack.states(row), pack.states(row + 1)
    return measure_scales(x, after, pack.context(episode).mask, pack.layout)


def _copy(into: Any, values: Any) -> None:
    """Copies every tensor of nested tuples in place."""
    for target, value in zip(into, values, strict=True):
        if isinstance(target, Tensor):
            target.copy_(value, non_blocking=True)
        elif target is not None:
            _copy(target, value)
