"""Equation RSSM, z_t = f_enc(h_t, x_t): the latent of each entity from its memory and state."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class Encoder(nn.Module):
    """Equation RSSM, z_t = f_enc(h_t, x_t), for each token.

    Robot, objects and parts have a first layer of their own, since their states differ.

    Args:
      robot, objects: numbers of features of a robot (0: there is none) and of an object.
      width: of tokens and memory.
      parts: number of features of a part of a mechanism (0: there is none).
    """

    def __init__(self, robot: int, objects: int, width: int, parts: int = 0) -> None:
        super().__init__()
        self.robot = _perceptron(robot + width, width) if robot else None
        self.objects = _perceptron(objects + width, width) if objects else None
        self.parts = _perceptron(parts + width, width) if parts else None

    def forward(
        self, h: Tensor, robot: Tensor, objects: Tensor, parts: Tensor | None = None
    ) -> Tensor:
        """z [B, K, width] from h, robot [B, F], objects [B, N, G] and parts [B, P, H]."""
        tokens, first = [], int(self.robot is not None)
        if self.robot is not None:
            tokens.append(self.robot(torch.cat([h[:, :1], robot[:, None]], dim=-1)))
        if self.objects is not None:
            seen = h[:, first : first + objects.shape[1]]
            tokens.append(self.objects(torch.cat([seen, objects], dim=-1)))
            first += objects.shape[1]
        if self.parts is not None and parts is not None:
            tokens.append(self.parts(torch.cat([h[:, first:], parts], dim=-1)))
        return tokens[0] if len(tokens) == 1 else torch.cat(tokens, dim=1)


def _perceptron(inputs: int, width: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(inputs, 2 * width), nn.SiLU(), nn.Linear(2 * width, width), nn.LayerNorm(width)
    )
