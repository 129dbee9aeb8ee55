"""The workflows of the paper: rollouts of images from states, with or without visual context."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from orbisim.host.progress import track
from orbisim_diffusion import edm
from orbisim_diffusion.autoencoder import to_bytes, to_float
from orbisim_diffusion.config import MOST_CONTEXT
from orbisim_diffusion.denoiser import Condition
from orbisim_diffusion.loop import mixed
from orbisim_diffusion.model import Painter
from orbisim_diffusion.store import Store

Workflow = Literal["GT-first", "GT-state", "Recon-first", "Recon-all"]
"""GT-first and GT-state begin with a true image (their states differ: predicted or true);
Recon-first with an image made from the first state; Recon-all uses no images as context."""
_DECODE = 128  # images at once, so that memory does not grow with the number of videos
_SEEDS = 1_000_003  # of one rollout and the next: more than there are frames


@torch.no_grad()  # type: ignore[untyped-decorator]
def rollout(
    painter: Painter,
    store: Store,
    episodes: Tensor,
    workflow: Workflow,
    horizon: int,
    steps: int,
    seed: int = 0,
) -> Tensor:
    """Images of episodes [E], autoregressive.

    Args:
      painter: the model. store: true images, and the states' geoms (predicted ones by
        `Store.with_poses`). episodes: numbers. workflow: see `Workflow`.
      horizon: frames after the first. steps: of the sampler. seed: of its noise.

    Returns:
      [E, horizon, H, W, 3] uint8: frames 1 to `horizon`.
    """
    first, past = store.first[episodes], []
    seed *= _SEEDS
    if workflow in ("GT-first", "GT-state"):
        with mixed(store.device):
            past.append(painter.encode(to_float(store.frames[first])))
    elif workflow == "Recon-first":
        past.append(_frame(painter, store, first, [], steps, seed))
    found = []
    for t in track(range(1, horizon + 1), f"images, {workflow}"):
        context = [] if workflow == "Recon-all" else past[-MOST_CONTEXT:]
        latent = _frame(painter, store, first + t, context, steps, seed + t)
        past.append(latent)
        found.append(latent)
        past = past[-MOST_CONTEXT:]
    return decoded(painter, torch.stack(found, 1))


def decoded(painter: Painter, latents: Tensor) -> Tensor:
    """Images [E, T, H, W, 3] uint8 of latents [E, T, C, h, w]."""
    parts = []
    for part in latents.flatten(0, 1).split(_DECODE):
        with mixed(latents.device):
            parts.append(to_bytes(painter.decode(part)))
    return torch.cat(parts).unflatten(0, latents.shape[:2])


def _frame(
    painter: Painter, store: Store, index: Tensor, past: list[Tensor], steps: int, seed: int
) -> Tensor:
    maps, tokens, there = store.conditions(index, painter.config.denoiser)
    given = Condition(*painter.history(past, len(index), maps), maps, tokens, there)
    noise = edm_noise(painter.shape(len(index), maps), store.device, seed)
    with mixed(store.device):
        return painter.paint(given, noise, steps)


def edm_noise(shape: tuple[int, ...], device: torch.device, seed: int) -> Tensor:
    """What sampling starts from: the same for a seed wherever it is drawn."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(shape, generator=generator).to(device)


__all__ = ["Workflow", "decoded", "edm", "rollout"]
