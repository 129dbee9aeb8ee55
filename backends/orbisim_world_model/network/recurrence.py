"""Equation RSSM, h_t = f_rec(h_{t-1}, e_t): the memory of each entity."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class Recurrence(nn.Module):
    """Equation RSSM, h_t = f_rec(h_{t-1}, e_t): a gated recurrent unit shared by all tokens.

    Args:
      width: of tokens and memory.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.cell = nn.Linear(2 * width, 3 * width)
        self.norm = nn.LayerNorm(3 * width)

    def forward(self, h: Tensor, e: Tensor) -> Tensor:
        """h_t [B, K, width] from h_{t-1} and e_t [B, K, width]."""
        reset, candidate, update = self.norm(self.cell(torch.cat([h, e], dim=-1))).chunk(3, dim=-1)
        candidate = torch.tanh(torch.sigmoid(reset) * candidate)
        update = torch.sigmoid(update - 1.0)  # remembers at first
        return update * candidate + (1.0 - update) * h
