"""Equation RSSM, z_t = f_enc(h_t, x_t): the latent of each entity from its memory and state."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class Encoder(nn.Module):
    """Equation RSSM, z_t = f_enc(h_t, x_t), for each token.

    Robot and objects have a first layer of their own, since their states differ.

    Args:
      robot, objects: numbers of features of a robot (0: there is none) and of an object.
      width: of tokens and memory.
    """

    def __init__(self, robot: int, objects: int, width: int) -> None:
        super().__init__()
        self.robot = _perceptron(robot + width, width) if robot else None
        self.objects = _perceptron(objects + width, width) if objects else None

    def forward(self, h: Tensor, robot: Tensor, objects: Tensor) -> Tensor:
        """z [B, K, width] from h [B, K, width], robot [B, F], objects [B, N, G]."""
        tokens = []
        if self.robot is not None:
            tokens.append(self.robot(torch.cat([h[:, :1], robot[:, None]], dim=-1)))
        if self.objects is not None:
            first = int(self.robot is not None)
            tokens.append(self.objects(torch.cat([h[:, first:], objects], dim=-1)))
        return tokens[0] if len(tokens) == 1 else torch.cat(tokens, dim=1)


def _perceptron(inputs: int, width: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(inputs, 2 * width), nn.SiLU(), nn.Linear(2 * width, width), nn.LayerNorm(width)
    )
