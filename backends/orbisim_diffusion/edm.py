"""The diffusion process: preconditioning, noise levels, weights and loss, an equation a function.

Notation and preconditioning follow Karras et al., "Elucidating the Design Space of Diffusion-Based
Generative Models" (2022), table 1; sigma is the noise level, sigma_data the data's deviation.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import torch
from torch import Tensor

from orbisim_diffusion.solids import constant

SIGMA_MIN, SIGMA_MAX, RHO = 0.002, 80.0, 7.0
"""Range and spacing of noise levels in sampling (table 1 there)."""


def c_skip(sigma: Tensor, data: float) -> Tensor:
    """c_skip = sigma_data^2 / (sigma^2 + sigma_data^2)."""
    return data**2 / (sigma**2 + data**2)


def c_out(sigma: Tensor, data: float) -> Tensor:
    """c_out = sigma sigma_data / sqrt(sigma^2 + sigma_data^2)."""
    return sigma * data / (sigma**2 + data**2).sqrt()


def c_in(sigma: Tensor, data: float) -> Tensor:
    """c_in = 1 / sqrt(sigma^2 + sigma_data^2)."""
    return 1.0 / (sigma**2 + data**2).sqrt()


def c_noise(sigma: Tensor) -> Tensor:
    """c_noise = ln(sigma) / 4."""
    return sigma.log() / 4.0


def weight(sigma: Tensor, data: float) -> Tensor:
    """w(sigma) = (sigma^2 + sigma_data^2) / (sigma sigma_data)^2: unit loss at every level."""
    return (sigma**2 + data**2) / (sigma * data) ** 2


def draw_sigma(count: int, mean: float, std: float, device: torch.device) -> Tensor:
    """p(sigma): ln sigma is normally distributed; [count]."""
    levels: Tensor = (torch.randn(count, device=device) * std + mean).exp()
    return levels.clamp(SIGMA_MIN, SIGMA_MAX)


def draw_anchor_noise(count: int, low: float, high: float, device: torch.device) -> Tensor:
    """Noise levels of the anchor latent, log-uniform; [count]."""
    span = torch.tensor(high / low, device=device).log()
    return low * (torch.rand(count, device=device) * span).exp()


def denoising_loss(denoised: Tensor, target: Tensor, sigma: Tensor, data: float) -> Tensor:
    """L_vis = E[w(sigma) |D(y + sigma eps; c)_t - y_t|^2], on the target frame alone.

    Args:
      denoised: [B, C, H, W] the denoiser's last slot. target: the clean latent.
      sigma: [B]. data: sigma_data.
    """
    squares = (denoised - target).square().mean((1, 2, 3))
    return (weight(sigma, data) * squares).mean()


def levels(steps: int, device: torch.device) -> Tensor:
    """Noise levels [steps + 1] of a sampler, from the noisiest to 0 (equation 5 there)."""
    if steps == 1:
        return constant((SIGMA_MAX, 0.0), torch.empty(0, device=device))
    ramp = torch.linspace(0, 1, steps, device=device)
    high, low = SIGMA_MAX ** (1 / RHO), SIGMA_MIN ** (1 / RHO)
    sigma: Tensor = (high + ramp * (low - high)) ** RHO
    return torch.cat([sigma, sigma.new_zeros(1)])


def sample(denoise: Callable[[Tensor, Tensor], Tensor], noise: Tensor, steps: int) -> Tensor:
    """Euler's method along the probability flow, from noise of unit variance [B, C, H, W].

    Args:
      denoise: D(y; sigma), of latents and levels [B].
      noise: what to start from; the target's placeholder is zero.
      steps: evaluations of the denoiser; with one, its answer to pure noise.
    """
    sigma = levels(steps, noise.device)
    y = sigma[0] * noise
    for now, following in itertools.pairwise(sigma):
        clean = denoise(y, now.expand(len(y)))
        y = clean + (following / now) * (y - clean)
    return y
