"""Equation AdaLN: AdaLN(u, c) = gamma(c) * LN(u) + beta(c)."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class AdaptiveLayerNorm(nn.Module):
    """Equation AdaLN: AdaLN(u, c) = gamma(c) * LN(u) + beta(c).

    `u` is a token's feature (its physical state), `c` its condition (actions and static
    descriptors); gamma and beta are linear in c, and start as 1 and 0.

    Args:
      width: of u.
      condition: width of c.
    """

    def __init__(self, width: int, condition: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width, elementwise_affine=False)
        self.modulation = nn.Linear(condition, 2 * width)
        nn.init.zeros_(self.modulation.weight)
        with torch.no_grad():
            self.modulation.bias.copy_(torch.cat([torch.ones(width), torch.zeros(width)]))

    def forward(self, u: Tensor, c: Tensor) -> Tensor:
        """[..., width] from u [..., width] and c [..., condition]."""
        gamma, beta = self.modulation(c).chunk(2, dim=-1)
        return gamma * self.norm(u) + beta
