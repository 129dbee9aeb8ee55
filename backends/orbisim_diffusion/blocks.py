"""The parts that both networks are built of: residual blocks, attention, noise embedding."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn.functional import group_norm, scaled_dot_product_attention

_GROUP = 8
"""Channels that a group normalisation takes together."""
_FREQUENCIES = 64
"""Random Fourier features of a noise level; the buffer `waves` of checkpoints has this length."""


class Norm(nn.GroupNorm):
    """Group normalisation that keeps half precision, where autocast would go on in single.

    Its statistics are summed up in single precision all the same; what it saves is memory traffic,
    which is what such small networks spend their time on.
    """

    def forward(self, x: Tensor) -> Tensor:
        """[N, C, H, W]."""
        if x.dtype not in (torch.bfloat16, torch.float16):
            return super().forward(x)
        with torch.autocast(x.device.type, enabled=False):
            weight, bias = self.weight.to(x.dtype), self.bias.to(x.dtype)
            return group_norm(x, self.num_groups, weight, bias, self.eps)


def norm(width: int) -> nn.GroupNorm:
    """Group normalisation."""
    return Norm(max(1, width // _GROUP), width)


def conv(inward: int, outward: int, stride: int = 1) -> nn.Conv2d:
    """A 3 x 3 convolution that keeps the size, or halves it with a stride of 2."""
    return nn.Conv2d(inward, outward, 3, stride, 1)


def silent(layer: nn.Module) -> nn.Module:
    """The layer with all parameters 0, so that what it is added to begins as it is."""
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)
    return layer


class ResidualBlock(nn.Module):
    """x + conv(silu(norm(conv(silu(norm(x)))))), scaled and shifted by an embedding.

    Args:
      inward, outward: channels.
      embedding: its width; 0 for none.
    """

    def __init__(self, inward: int, outward: int, embedding: int = 0) -> None:
        super().__init__()
        self.first = nn.Sequential(norm(inward), nn.SiLU(), conv(inward, outward))
        self.norm = norm(outward)
        self.second = nn.Sequential(nn.SiLU(), silent(conv(outward, outward)))
        self.skip = nn.Conv2d(inward, outward, 1) if inward != outward else nn.Identity()
        self.modulation = nn.Linear(embedding, 2 * outward) if embedding else None

    def forward(self, x: Tensor, embedding: Tensor | None = None) -> Tensor:
        """[N, C, H, W], and [N, E] of the embedding."""
        hidden = self.norm(self.first(x))
        if self.modulation is not None and embedding is not None:
            scale, shift = self.modulation(embedding)[..., None, None].chunk(2, dim=1)
            hidden = hidden * (1.0 + scale) + shift
        out: Tensor = self.skip(x) + self.second(hidden)
        return out


class Attention(nn.Module):
    """Multi-head attention of a sequence to itself or to another one, with a residual.

    Args:
      width: of the sequence. heads: of attention. context: width of the other sequence; 0 for
        attention to itself.
    """

    def __init__(self, width: int, heads: int, context: int = 0) -> None:
        super().__init__()
        self.heads = heads
        self.norm = nn.LayerNorm(width)
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(context or width, 2 * width)
        self.out = silent(nn.Linear(width, width))

    def forward(
        self, x: Tensor, context: Tensor | None = None, mask: Tensor | None = None
    ) -> Tensor:
        """x [N, L, C]; context [N, M, D]; mask [N, M], True where there is something to see."""
        hidden = self.norm(x)
        source = hidden if context is None else context
        query = self._split(self.query(hidden))
        key, value = (self._split(part) for part in self.key_value(source).chunk(2, dim=-1))
        seen = None if mask is None else mask[:, None, None]
        found = scaled_dot_product_attention(query, key, value, attn_mask=seen)
        out: Tensor = x + self.out(found.transpose(1, 2).flatten(2))
        return out

    def _split(self, x: Tensor) -> Tensor:
        return x.unflatten(-1, (self.heads, -1)).transpose(1, 2)


class NoiseEmbedding(nn.Module):
    """Embedding [N, width] of noise levels [N]: random Fourier features and two layers."""

    def __init__(self, width: int) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(0)
        self.register_buffer("waves", torch.randn(_FREQUENCIES, generator=generator))
        self.layers = nn.Sequential(
            nn.Linear(2 * _FREQUENCIES, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU()
        )

    def forward(self, level: Tensor) -> Tensor:
        """`level`: c_noise."""
        angle = 2.0 * math.pi * level[:, None] * self.waves
        embedded: Tensor = self.layers(torch.cat([angle.cos(), angle.sin()], dim=-1))
        return embedded


def as_sequence(x: Tensor) -> Tensor:
    """[N, C, H, W] to [N, H * W, C]."""
    return x.flatten(2).transpose(1, 2)


def as_image(x: Tensor, height: int, width: int) -> Tensor:
    """[N, H * W, C] to [N, C, H, W]."""
    return x.transpose(1, 2).unflatten(-1, (height, width))
