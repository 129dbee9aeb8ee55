"""The three trainings: autoencoder, denoiser, one-step renderer."""

from __future__ import annotations

import copy
import dataclasses
import random
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from orbisim_diffusion import edm
from orbisim_diffusion.autoencoder import Autoencoder, autoencoder_loss, to_float
from orbisim_diffusion.config import MOST_CONTEXT, Config
from orbisim_diffusion.denoiser import Condition, Denoiser, perturbed_anchor
from orbisim_diffusion.loop import Kept, Loop, mixed
from orbisim_diffusion.store import Store, draw_frames

Report = Callable[[str], None]
_SETTLE = 4096
"""Frames whose latents give the scale of all."""


@dataclasses.dataclass(frozen=True)
class Run:
    """How long a part is trained, and where its progress is kept.

    Attributes:
      limit: s, earlier runs included. steps: at most so many; None for no bound.
      progress: file to go on from; None for none. seed: of all random numbers.
      compiled: whether torch compiles the networks (a minute or more, once).
    """

    limit: float
    steps: int | None = None
    progress: Path | None = None
    seed: int = 0
    compiled: bool = False


def train_autoencoder(
    config: Config,
    run: Run,
    store: Store,
    report: Report = print,
    start: Autoencoder | None = None,
) -> tuple[Autoencoder, Loop]:
    """Trains the autoencoder on single frames.

    Args:
      config: of the model. run: see `Run`. store: the data. report: is told how it goes.
      start: trained before, to go on with.
    """
    _seed(run.seed)
    model = copy.deepcopy(start) if start else Autoencoder(config.autoencoder)
    model = model.to(store.device, memory_format=torch.channels_last).requires_grad_(True)
    measure = torch.compile(autoencoder_loss) if run.compiled else autoencoder_loss
    loop = Loop(model, config.train_autoencoder, run.limit, run.progress, run.steps)

    def loss(_: int) -> Tensor:
        index = torch.randint(len(store), (config.train_autoencoder.batch,), device=store.device)
        images = to_float(store.frames[index]).contiguous(memory_format=torch.channels_last)
        with mixed(store.device):
            found: Tensor = measure(model, images)
            return found

    loop.run(loss, report=report)
    average = loop.average
    assert isinstance(average, Autoencoder)
    settle(average, store)
    return average, loop


@torch.no_grad()  # type: ignore[untyped-decorator]
def settle(model: Autoencoder, store: Store) -> None:
    """Takes the scale of the latents from frames spread over a store."""
    sample = store.frames[:: max(1, len(store) // _SETTLE)]
    model.settle(torch.cat([model.posterior(to_float(part))[0] for part in sample.split(256)]))


@torch.no_grad()  # type: ignore[untyped-decorator]
def encoded(model: Autoencoder, store: Store) -> Store:
    """The store with its latents."""
    parts = []
    for frames in store.frames.split(512):
        with mixed(store.device):
            parts.append(model.encode(to_float(frames)).half())
    return dataclasses.replace(store, latents=torch.cat(parts))


def draw_condition(store: Store, config: Config, frames: Tensor) -> tuple[Condition, Tensor]:
    """The condition and the clean target latent of frames [B, K + 1]."""
    assert store.latents is not None
    settings = config.denoiser
    latents = store.latents[frames].float() * settings.sigma_data  # [B, K + 1, C, h, w]
    context, target = latents[:, :-1], latents[:, -1]
    sigma = edm.draw_anchor_noise(len(frames), *settings.anchor, store.device)
    anchor = perturbed_anchor(context, target, sigma)
    if not settings.noisy_context:
        # own frames come back as context in a rollout: errors of the anchor's size are expected
        context = context + sigma[:, None, None, None, None] * torch.randn_like(context)
    maps, tokens, there = store.conditions(frames[:, -1], settings)
    return Condition(context, anchor, maps, tokens, there), target


def train_denoiser(
    config: Config,
    run: Run,
    store: Store,
    report: Report = print,
    start: Denoiser | None = None,
    kept: Kept | None = None,
) -> tuple[Denoiser, Loop]:
    """Trains the denoiser on a store with latents; K is uniform in 0 to 6, one for each batch.

    Args:
      config: of the model. run: see `Run`. store: the data. report: is told how it goes.
      start: trained before, to go on with. kept: see `orbisim_diffusion.loop.Kept`.
    """
    _seed(run.seed)
    model = (
        copy.deepcopy(start) if start else Denoiser(config.denoiser, config.autoencoder.channels)
    )
    model = model.to(store.device, memory_format=torch.channels_last).requires_grad_(True)
    denoise = torch.compile(model) if run.compiled else model
    settings, training = config.denoiser, config.train_denoiser
    loop = Loop(model, training, run.limit, run.progress, run.steps)

    def loss(step: int) -> Tensor:
        context = context_length(store)
        frames = draw_frames(store, training.batch, context, settings.consecutive)
        given, target = draw_condition(store, config, frames)
        sigma = edm.draw_sigma(len(frames), settings.noise_mean, settings.noise_std, store.device)
        noisy = target + sigma[:, None, None, None] * torch.randn_like(target)
        with mixed(store.device):
            denoised = denoise(noisy, sigma, given)
        return edm.denoising_loss(denoised, target, sigma, settings.sigma_data)

    loop.run(loss, report=report, kept=kept)
    average = loop.average
    assert isinstance(average, Denoiser)
    return average, loop


def train_one_step(
    config: Config,
    run: Run,
    store: Store,
    autoencoder: Autoencoder,
    start: Denoiser,
    report: Report = print,
    kept: Kept | None = None,
) -> tuple[Denoiser, Loop]:
    """Tunes a denoiser end to end to answer pure noise at once, through the frozen decoder.

    The loss is the squared error of the latent and, in images, that of the pixels.
    """
    _seed(run.seed)
    model = copy.deepcopy(start).requires_grad_(True)
    model = model.to(store.device, memory_format=torch.channels_last)
    frozen = autoencoder.to(store.device).requires_grad_(False)
    settings, training = config.denoiser, config.train_one_step
    loop = Loop(model, training, run.limit, run.progress, run.steps)

    def loss(step: int) -> Tensor:
        frames = draw_frames(store, training.batch, context_length(store), settings.consecutive)
        given, target = draw_condition(store, config, frames)
        sigma = torch.full((len(frames),), edm.SIGMA_MAX, device=store.device)
        noisy = sigma[:, None, None, None] * torch.randn_like(target)
        images = to_float(store.frames[frames[:, -1]])
        with mixed(store.device):
            clean = model(noisy, sigma, given)
            pixels = frozen.decode(clean / settings.sigma_data)
        return (clean - target).square().mean() + _PIXELS * (
            pixels.float() - images
        ).square().mean()

    loop.run(loss, report=report, kept=kept)
    average = loop.average
    assert isinstance(average, Denoiser)
    return average, loop


_PIXELS = 50.0
"""Weight of the pixels' squared error: at 30 dB it is 0.004, a latent's about 0.1."""


def context_length(store: Store) -> int:
    """K, uniform in 0 to 6, or to what the shortest episode allows."""
    return random.randint(0, min(MOST_CONTEXT, int(store.length.min()) - 1))


def _seed(seed: int) -> None:
    torch.manual_seed(seed)
    random.seed(seed)
