"""Equation RSSM, the predicted latent: zhat_t = f_tra(h_t)."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class Transition(nn.Module):
    """Equation RSSM, zhat_t = f_tra(h_t); with `skip` it also sees e_t.

    Args:
      width: of tokens and memory.
      skip: whether e_t is given too.
    """

    def __init__(self, width: int, skip: bool) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(2 * width if skip else width, 2 * width),
            nn.SiLU(),
            nn.Linear(2 * width, width),
        )
        self.skip = skip

    def forward(self, h: Tensor, e: Tensor) -> Tensor:
        """zhat_t [B, K, width] from h_t and e_t [B, K, width]."""
        if not self.skip:
            return self.layers(h)
        return e + self.layers(torch.cat([h, e], dim=-1))
