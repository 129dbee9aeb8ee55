"""`Normalizer`: to unit scale and back, with numbers taken from the training data."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class Normalizer(nn.Module):
    """(x - mean) / std for each feature; features that do not vary become 0.

    Args:
      size: number of features.
      centered: whether the mean is subtracted.
      output: what does not vary in the data is never predicted to vary.
    """

    def __init__(self, size: int, *, centered: bool = True, output: bool = False) -> None:
        super().__init__()
        self.centered, self.output = centered, output
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))

    def fit(self, values: Tensor, weights: Tensor | None = None) -> None:
        """Takes mean and standard deviation from values [..., size].

        Args:
          weights: [...], 0 for rows that do not count.
        """
        if not values.numel():
            return
        rows = values.reshape(-1, values.shape[-1]).double()
        if weights is not None:
            rows = rows[weights.reshape(-1) > 0]
        if not len(rows):
            return
        mean = rows.mean(0) if self.centered else torch.zeros_like(rows[0])
        std = (rows - mean).square().mean(0).sqrt()
        varies = std > 1e-5 * rows.abs().amax(0) + 1e-9  # more than rounding
        std = torch.where(varies, std, torch.full_like(std, 0.0 if self.output else 1.0))
        self.mean.copy_(mean)
        self.std.copy_(std)

    def forward(self, values: Tensor) -> Tensor:
        """Unit scale."""
        return (values - self.mean) / self.std

    def undo(self, values: Tensor) -> Tensor:
        """Back to SI units."""
        return values * self.std + self.mean


def fine(values: Tensor, scale: float) -> Tensor:
    """Linear below the scale, logarithmic above it."""
    return torch.asinh(values / scale)
