"""The state-guided latent video denoiser D(y_{t-K:t} + sigma eps; c_t)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from orbisim_diffusion import edm
from orbisim_diffusion.blocks import (
    Attention,
    NoiseEmbedding,
    ResidualBlock,
    as_image,
    as_sequence,
    conv,
    norm,
    silent,
)
from orbisim_diffusion.conditions import map_channels, token_features
from orbisim_diffusion.config import MOST_CONTEXT, DenoiserConfig


class Condition(NamedTuple):
    """c_t: what the target frame is conditioned on.

    Attributes:
      context: [B, K, C, h, w] clean latents y_{t-K:t-1}, K from 0 to 6.
      anchor: [B, C, h, w] perturbed copy of y_{t-1}; zeros where K is 0.
      maps: [B, M, 8h, 8w] spatial condition maps of the state at t.
      tokens: [B, G, F] object tokens, or what stands for them (see `DenoiserConfig.tokens`);
        there: [B, G] which of them are no padding.
    """

    context: Tensor
    anchor: Tensor
    maps: Tensor
    tokens: Tensor
    there: Tensor


class MapEncoder(nn.Module):
    """Spatial condition maps [B, M, 8h, 8w] to features [B, width, h, w]."""

    def __init__(self, maps: int, width: int) -> None:
        super().__init__()
        narrow = max(8, width // 24 * 8)  # a multiple of what is normalised together
        self.layers = nn.Sequential(
            conv(maps, narrow, stride=2),
            nn.SiLU(),
            conv(narrow, 2 * narrow, stride=2),
            ResidualBlock(2 * narrow, 2 * narrow),
            norm(2 * narrow),
            nn.SiLU(),
            conv(2 * narrow, width, stride=2),
            ResidualBlock(width, width),
        )

    def forward(self, maps: Tensor) -> Tensor:
        """See the class."""
        features: Tensor = self.layers(maps)
        return features


class VideoBlock(nn.Module):
    """Residual block of each frame, then attention over space, to object tokens, and over time."""

    def __init__(self, inward: int, width: int, config: DenoiserConfig, attend: bool) -> None:
        super().__init__()
        self.residual = ResidualBlock(inward, width, _embedding(config))
        self.space = Attention(width, config.heads) if attend else None
        self.tokens = Attention(width, config.heads, config.token) if attend else None
        self.time = Attention(width, config.heads) if attend else None

    def forward(
        self, x: Tensor, embedding: Tensor, tokens: Tensor, there: Tensor, frames: int
    ) -> Tensor:
        """x [B * frames, C, h, w]; embedding [B * frames, E]; tokens [B, G, D]."""
        x = self.residual(x, embedding)
        if self.space is None or self.tokens is None or self.time is None:
            return x
        height, width = x.shape[-2:]
        sequence = self.space(as_sequence(x))  # [B * frames, h * w, C]
        video = sequence.unflatten(0, (-1, frames))
        # the last frame is the one that the state belongs to
        last = self.tokens(video[:, -1], tokens, there)
        video = torch.cat([video[:, :-1], last[:, None]], dim=1)
        if frames > 1:
            pixels = video.transpose(1, 2).flatten(0, 1)  # [B * h * w, frames, C]
            video = self.time(pixels).unflatten(0, (-1, height * width)).transpose(1, 2)
        return as_image(video.flatten(0, 1), height, width)


class Denoiser(nn.Module):
    """Denoiser: a video U-Net of two sizes over the sequence y_{t-K:t}.

    Each frame is a slot: its (noisy) latent, its clean latent (context only), the anchor, and the
    features of the condition maps (target only), concatenated by channel.

    Args:
      config: of the network. channels: C of a latent.
    """

    def __init__(self, config: DenoiserConfig, channels: int) -> None:
        super().__init__()
        self.config, self.channels = config, channels
        a, b = config.widths
        count = config.blocks
        self.maps = MapEncoder(map_channels(config), a)
        self.noise = NoiseEmbedding(_embedding(config))
        self.age = nn.Embedding(MOST_CONTEXT + 1, _embedding(config))
        self.token = nn.Sequential(
            nn.Linear(token_features(config), config.token),
            nn.SiLU(),
            nn.Linear(config.token, config.token),
        )
        self.enter = conv(3 * channels + a, a)
        self.down = nn.ModuleList(VideoBlock(a, a, config, False) for _ in range(count))
        self.shrink = conv(a, b, stride=2)
        self.middle = nn.ModuleList(VideoBlock(b, b, config, True) for _ in range(count))
        self.grow = nn.Sequential(nn.Upsample(scale_factor=2.0), conv(b, a))
        self.up = nn.ModuleList(
            VideoBlock(2 * a if i == 0 else a, a, config, False) for i in range(count)
        )
        self.leave = nn.Sequential(norm(a), nn.SiLU(), silent(conv(a, channels)))

    def forward(self, noisy: Tensor, sigma: Tensor, given: Condition) -> Tensor:
        """D(y; sigma, c) = c_skip y + c_out F(c_in y; c_noise, c), the target's slot.

        Args:
          noisy: [B, C, h, w] the target's latent with noise. sigma: [B] its level.
          given: the condition.

        Returns:
          [B, C, h, w]: the clean latent as the network sees it.
        """
        data, level = self.config.sigma_data, sigma[:, None, None, None]
        inner = self.network(edm.c_in(level, data) * noisy, sigma, given)
        return edm.c_skip(level, data) * noisy + edm.c_out(level, data) * inner.float()

    def network(self, scaled: Tensor, sigma: Tensor, given: Condition) -> Tensor:
        """F: the U-Net itself; arguments as for `forward`, the latent already scaled."""
        x, frames = self._slots(scaled, sigma, given), given.context.shape[1] + 1
        batch, size = x.shape[0], x.shape[-2:]
        age = self.age(torch.arange(frames - 1, -1, -1, device=x.device))
        embedding = (self.noise(edm.c_noise(sigma))[:, None] + age).flatten(0, 1)
        tokens = self.token(given.tokens)
        side = embedding, tokens, given.there, frames
        x = self.enter(x.flatten(0, 1))
        for block in self.down:
            x = block(x, *side)
        kept, x = x, self.shrink(x)
        for block in self.middle:
            x = block(x, *side)
        # frames meet in the middle alone: on the way up the target's is all that is needed
        x, kept, embedding = (
            part.unflatten(0, (batch, frames))[:, -1] for part in (x, kept, embedding)
        )
        x = torch.cat([self.grow(x)[..., : size[0], : size[1]], kept], dim=1)
        for block in self.up:
            x = block(x, embedding, tokens, given.there, 1)
        out: Tensor = self.leave(x)
        return out

    def _slots(self, scaled: Tensor, sigma: Tensor, given: Condition) -> Tensor:
        """[B, K + 1, 3 C + features, h, w]."""
        context = given.context
        target = self.maps(given.maps)
        none = torch.zeros_like(target)[:, None].expand(-1, context.shape[1], -1, -1, -1)
        features = torch.cat([none, target[:, None]], dim=1)
        noisy = context
        if self.config.noisy_context and context.shape[1]:
            level = sigma[:, None, None, None, None]
            noisy = (context + level * torch.randn_like(context)) * edm.c_in(
                level, self.config.sigma_data
            )
        clean = torch.cat([context, torch.zeros_like(scaled)[:, None]], dim=1)
        latents = torch.cat([noisy, scaled[:, None]], dim=1)
        anchor = given.anchor[:, None].expand_as(latents)
        return torch.cat([latents, clean, anchor, features.to(latents.dtype)], dim=2)


def perturbed_anchor(context: Tensor, like: Tensor, sigma: Tensor) -> Tensor:
    """Visual anchoring: y_{t-1} + sigma_anchor eps; zeros where there is no context.

    Args:
      context: [B, K, C, h, w]. like: [B, C, h, w], whose shape is returned. sigma: [B].
    """
    if not context.shape[1]:
        return torch.zeros_like(like)
    last = context[:, -1]
    return last + sigma[:, None, None, None] * torch.randn_like(last)


def _embedding(config: DenoiserConfig) -> int:
    return 2 * config.widths[0]
