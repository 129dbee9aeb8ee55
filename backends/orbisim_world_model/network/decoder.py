"""Equation RSSM, the predicted state: xhat_t = f_dec(zhat_t)."""

from __future__ import annotations

from torch import Tensor, nn


class Decoder(nn.Module):
    """Equation RSSM, xhat_t = f_dec(zhat_t), as numbers that `integrate.advance` understands.

    Args:
      width: of tokens.
      robot, objects: numbers for the robot (0: there is none) and for an object.
      count: number of objects.
      parts: numbers for a part of a mechanism (0: there is none).
    """

    def __init__(self, width: int, robot: int, objects: int, count: int, parts: int = 0) -> None:
        super().__init__()
        self.outputs = objects
        self.robot = _head(width, robot) if robot else None
        self.objects = _head(width, objects) if count else None
        self.count = count
        self.parts = _head(width, parts) if parts else None

    def part_numbers(self, z: Tensor) -> Tensor | None:
        """Parts [B, P, 3] from zhat [B, K, width], whose last tokens they are."""
        if self.parts is None:
            return None
        found: Tensor = self.parts(z[:, int(self.robot is not None) + self.count :])
        return found

    def forward(self, z: Tensor) -> tuple[Tensor, Tensor]:
        """Robot [B, R] and objects [B, N, O] from zhat [B, K, width]."""
        first = int(self.robot is not None)
        robot = self.robot(z[:, 0]) if self.robot is not None else z.new_zeros((len(z), 0))
        if self.objects is None:
            return robot, z.new_zeros((len(z), 0, self.outputs))
        return robot, self.objects(z[:, first : first + self.count])


def _head(width: int, outputs: int) -> nn.Sequential:
    last = nn.Linear(width, outputs)
    nn.init.zeros_(last.bias)
    nn.init.normal_(last.weight, std=1e-2)
    return nn.Sequential(nn.Linear(width, width), nn.SiLU(), last)
