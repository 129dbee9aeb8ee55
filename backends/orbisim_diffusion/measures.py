"""What a training is measured by: reconstruction and single frames of held-out episodes."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from orbisim_diffusion.autoencoder import Autoencoder, to_bytes, to_float
from orbisim_diffusion.denoiser import Condition
from orbisim_diffusion.loop import mixed
from orbisim_diffusion.model import Painter
from orbisim_diffusion.quality import psnr, ssim
from orbisim_diffusion.store import Store
from orbisim_diffusion.workflows import edm_noise

_SAMPLE = 512
"""Frames, spread over the store."""


def spread(frames: int, device: torch.device, count: int = _SAMPLE) -> Tensor:
    """Numbers of some of so many frames, at equal distances."""
    return torch.linspace(0, frames - 1, min(count, frames), device=device).round().long()


@torch.no_grad()  # type: ignore[untyped-decorator]
def reconstruction(model: Autoencoder, store: Store) -> dict[str, float]:
    """PSNR and SSIM of dec(enc(o)): what bounds everything that follows."""
    found, true = [], []
    for index in spread(len(store), store.device).split(64):
        with mixed(store.device):
            found.append(to_bytes(model.decode(model.encode(to_float(store.frames[index])))))
        true.append(store.frames[index])
    return compared(torch.cat(found), torch.cat(true))


@torch.no_grad()  # type: ignore[untyped-decorator]
def single_frames(
    painter: Painter, store: Store, steps: Sequence[int] = (1, 4), context: Sequence[int] = (0, 1)
) -> dict[str, float]:
    """PSNR of frames from true states, by steps of the sampler, without and with a true image."""
    found = {}
    index = spread(len(store), store.device)
    index = index[(index - 1).clamp_min(0) >= store.first[store.episode[index]]]
    for count in context:
        for number in steps:
            images = torch.cat([_frames(painter, store, i, count, number) for i in index.split(64)])
            key = f"psnr_{number}_steps_context_{count}"
            found[key] = float(psnr(images, store.frames[index]).mean())
    return {name: round(value, 3) for name, value in found.items()}


def _frames(painter: Painter, store: Store, index: Tensor, context: int, steps: int) -> Tensor:
    maps, tokens, there = store.conditions(index, painter.config.denoiser)
    with mixed(store.device):
        past = [painter.encode(to_float(store.frames[index - 1]))] * context
        given = Condition(*painter.history(past, len(index), maps), maps, tokens, there)
        noise = edm_noise(painter.shape(len(index), maps), store.device, 0)
        return to_bytes(painter.decode(painter.paint(given, noise, steps)))


def compared(found: Tensor, true: Tensor) -> dict[str, float]:
    """Mean PSNR and SSIM of uint8 images [N, H, W, 3]."""
    alike = torch.cat([ssim(a, b) for a, b in zip(found.split(64), true.split(64), strict=True)])
    return {
        "psnr": round(float(psnr(found, true).mean()), 3),
        "ssim": round(float(alike.mean()), 4),
    }
