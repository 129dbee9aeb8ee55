"""Equation RSSM, e_t = f_cp(z_{t-1}, a_{t-1}, x): what the entities do to each other."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from orbisim_world_model.network.adaln import AdaptiveLayerNorm

PAIR = 64
"""Numbers that stand for a pair of tokens."""


class Coupling(nn.Module):
    """Equation RSSM, e_t = f_cp(z_{t-1}, a_{t-1}, x): a transformer over the entities.

    Global self-attention; actions and descriptors enter through AdaLN as each token's condition.

    Args:
      width, layers, heads, expansion: of the transformer.
      edge: number of features of a pair of tokens (0: none).
    """

    def __init__(self, width: int, layers: int, heads: int, expansion: int, edge: int) -> None:
        super().__init__()
        self.edge = None
        if edge:
            self.edge = nn.Sequential(
                nn.Linear(edge, 96), nn.SiLU(), nn.Linear(96, PAIR), nn.SiLU()
            )
        self.blocks = nn.ModuleList(
            Block(width, heads, expansion, PAIR if edge else 0) for _ in range(layers)
        )
        self.norm = nn.LayerNorm(width)

    def pairs(self, edges: Tensor | None) -> Tensor | None:
        """What tokens make of each other's edges [B, K, K, E]: [B, K, K, PAIR]."""
        return None if self.edge is None else self.edge(edges)

    def forward(self, z: Tensor, c: Tensor, pairs: Tensor | None, mask: Tensor | None) -> Tensor:
        """e [B, K, width] from z and c [B, K, width], `pairs` and mask [B, K]."""
        for block in self.blocks:
            z = block(z, c, pairs, mask)
        return self.norm(z)


class Block(nn.Module):
    """Self-attention and a feed-forward layer, each behind an AdaLN.

    With features of pairs, token i sees token j through keys and values that depend on the pair.
    """

    def __init__(self, width: int, heads: int, expansion: int, pair: int) -> None:
        super().__init__()
        self.heads = heads
        self.before_attention = AdaptiveLayerNorm(width, width)
        self.before_mixing = AdaptiveLayerNorm(width, width)
        self.qkv = nn.Linear(width, 3 * width)
        self.pair = nn.Linear(pair, 2 * width) if pair else None
        self.out = nn.Linear(width, width)
        self.mix = nn.Sequential(
            nn.Linear(width, expansion * width), nn.SiLU(), nn.Linear(expansion * width, width)
        )

    def forward(self, z: Tensor, c: Tensor, pairs: Tensor | None, mask: Tensor | None) -> Tensor:
        """[B, K, width]."""
        z = z + self.out(self.attention(self.before_attention(z, c), pairs, mask))
        return z + self.mix(self.before_mixing(z, c))

    def attention(self, u: Tensor, pairs: Tensor | None, mask: Tensor | None) -> Tensor:
        """Global self-attention [B, K, width] over tokens that the mask [B, K] lets be seen."""
        count, width = u.shape[1:]
        if count == 1 and pairs is None:
            return self.qkv(u)[..., 2 * width :]  # it can only look at itself
        q, k, v = self.qkv(u).chunk(3, dim=-1)
        k, v = k[:, None], v[:, None]  # [B, 1, K, width]
        if self.pair is not None:
            pair_k, pair_v = self.pair(pairs).chunk(2, dim=-1)  # [B, K, K, width]
            k, v = k + pair_k, v + pair_v
        split = (self.heads, width // self.heads)
        q, k, v = q[:, :, None].unflatten(-1, split), k.unflatten(-1, split), v.unflatten(-1, split)
        score = (q * k).sum(-1) * split[1] ** -0.5  # [B, K, K, heads]
        if mask is not None:
            score = score.masked_fill(mask[:, None, :, None] == 0, -1e4)
        seen = (score.softmax(dim=2)[..., None] * v).sum(2)  # [B, K, heads, width / heads]
        return seen.flatten(-2)


def token_mask(mask: Tensor, has_robot: bool, parts: Tensor | None = None) -> Tensor:
    """[B, K]: 1 for the robot, if there is one, the objects' mask [B, N] and the parts' [B, P]."""
    if parts is not None:
        return torch.cat([mask.new_ones((len(mask), int(has_robot))), mask, parts], dim=1)
    return torch.cat([torch.ones_like(mask[:, :1]), mask], dim=1) if has_robot else mask
