"""The KL autoencoder between images and latents, eight times smaller along each side."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from orbisim_diffusion.blocks import ResidualBlock, conv, norm
from orbisim_diffusion.config import AutoencoderConfig

_LOGVAR = (-12.0, 4.0)
"""Bounds of the posterior's log variance: beyond them exp makes training unstable."""


class Autoencoder(nn.Module):
    """VAE: y = enc(o), o = dec(y).

    Images are [N, 3, H, W] from -1 to 1, latents [N, C, H/8, W/8]. The latents that `encode` gives
    have zero mean and unit variance by channel over the training data (`settle`).
    """

    def __init__(self, config: AutoencoderConfig) -> None:
        super().__init__()
        self.config = config
        a, b, c = config.widths
        n, z = config.blocks, config.channels
        self.encoder = nn.Sequential(
            nn.PixelUnshuffle(2),
            conv(12, a),
            *(ResidualBlock(a, a) for _ in range(n)),
            conv(a, b, stride=2),
            *(ResidualBlock(b, b) for _ in range(n)),
            conv(b, c, stride=2),
            *(ResidualBlock(c, c) for _ in range(n)),
            norm(c),
            nn.SiLU(),
            conv(c, 2 * z),
        )
        self.decoder = nn.Sequential(
            conv(z, c),
            *(ResidualBlock(c, c) for _ in range(n + 1)),
            nn.Upsample(scale_factor=2.0),
            conv(c, b),
            *(ResidualBlock(b, b) for _ in range(n + 1)),
            nn.Upsample(scale_factor=2.0),
            conv(b, a),
            *(ResidualBlock(a, a) for _ in range(n + 1)),
            norm(a),
            nn.SiLU(),
            conv(a, 12),
            nn.PixelShuffle(2),
        )
        self.register_buffer("mean", torch.zeros(z))
        self.register_buffer("std", torch.ones(z))

    def posterior(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log variance of q(y | o), before `settle`."""
        mean, logvar = self.encoder(images).chunk(2, dim=1)
        return mean, logvar.clamp(*_LOGVAR)

    def encode(self, images: Tensor) -> Tensor:
        """The mean of q(y | o), normalised."""
        mean, _ = self.posterior(images)
        return (mean - self.mean[:, None, None]) / self.std[:, None, None]

    def decode(self, latents: Tensor) -> Tensor:
        """Images of normalised latents."""
        raw = latents * self.std[:, None, None] + self.mean[:, None, None]
        images: Tensor = self.decoder(raw)
        return images

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def settle(self, means: Tensor) -> None:
        """Takes the scale of latents [N, C, h, w], as `posterior` gives their means."""
        self.mean.copy_(means.mean((0, 2, 3)))
        self.std.copy_(means.std((0, 2, 3)).clamp_min(1e-3))


def kl_divergence(mean: Tensor, logvar: Tensor) -> Tensor:
    """KL of q(y | o) from a standard normal distribution, mean over all numbers."""
    return 0.5 * (mean.square() + logvar.exp() - 1.0 - logvar).mean()


def autoencoder_loss(model: Autoencoder, images: Tensor, kl: float = 1e-6) -> Tensor:
    """|o - dec(y)|^2 + |o - dec(y)| / 10 + kl KL(q(y | o) | N(0, 1)), y drawn from q.

    The absolute part keeps outlines sharp, the square is what PSNR measures.
    """
    mean, logvar = model.posterior(images)
    drawn = mean + (0.5 * logvar).exp() * torch.randn_like(mean)
    error = (model.decoder(drawn) - images).float()
    return error.square().mean() + 0.1 * error.abs().mean() + kl * kl_divergence(mean, logvar)


def to_float(images: Tensor) -> Tensor:
    """uint8 [..., H, W, 3] to [..., 3, H, W] from -1 to 1."""
    return images.movedim(-1, -3).float() / 127.5 - 1.0


def to_bytes(images: Tensor) -> Tensor:
    """[..., 3, H, W] from -1 to 1 to uint8 [..., H, W, 3]."""
    return ((images.float() + 1.0) * 127.5).round().clamp(0, 255).to(torch.uint8).movedim(-3, -1)
