"""The training of StaInf on a store with latents of the frozen encoder."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from orbisim_diffusion.config import Config, TrainConfig
from orbisim_diffusion.inference import (
    Inferred,
    StateInference,
    Truth,
    errors,
    inference_loss,
    robots,
    truth,
)
from orbisim_diffusion.loop import Loop, mixed
from orbisim_diffusion.measures import spread
from orbisim_diffusion.store import Store
from orbisim_diffusion.training import Run

TRAIN = TrainConfig(batch=512, rate=5e-4, warmup=500)
_NOISE = 0.1
"""Largest noise on latents in training: images that a model made are not quite true ones."""


def train_inference(
    config: Config, run: Run, store: Store, report: Callable[[str], None] = print
) -> tuple[StateInference, Loop]:
    """Trains StaInf; `store` has latents and a robot in every episode."""
    torch.manual_seed(run.seed)
    model = StateInference(config.autoencoder.channels, config.size).to(store.device)
    loop = Loop(model, TRAIN, run.limit, run.progress, run.steps)
    robot, latents = robots(store), store.latents
    assert latents is not None
    batch = min(TRAIN.batch, len(store))

    def loss(_: int) -> Tensor:
        index = torch.randint(len(store), (batch,), device=store.device)
        clean = latents[index].float()
        share = torch.rand(batch, 1, 1, 1, device=store.device) * _NOISE
        with mixed(store.device):
            found = model(clean + share * torch.randn_like(clean))
        return inference_loss(found, truth(store, robot, index))

    loop.run(loss, report=report)
    average = loop.average
    assert isinstance(average, StateInference)
    return average, loop


@torch.no_grad()  # type: ignore[untyped-decorator]
def inference_errors(model: StateInference, store: Store, count: int = 8192) -> dict[str, float]:
    """Errors on frames of a store with latents, spread over it."""
    assert store.latents is not None
    robot, found, true = robots(store), [], []
    for index in spread(store, count).split(1024):
        found.append(model(store.latents[index].float()))
        true.append(truth(store, robot, index))
    return errors(
        Inferred(*map(torch.cat, zip(*found, strict=True))),
        Truth(*map(torch.cat, zip(*true, strict=True))),
    )
