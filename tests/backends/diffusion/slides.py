"""A world in which all is known: boxes that slide until friction has stopped them."""

from __future__ import annotations

import types
from typing import Any

import torch
from orbisim_diffusion.physics import FRAMES, Window
from orbisim_diffusion.physics_data import Truth
from torch import Tensor

STEP, GRAVITY = 0.05, 9.81
LOW, HIGH = 0.05, 0.4


class Slides:
    """In half of the windows two boxes are set going, in the other half they rest.

    Densities are drawn, and show nowhere. Stands for `Windows` and `FreeRuns` alike: what is known
    of a window is in `Truth.first`, its number among those that were drawn last.
    """

    def __init__(self, episodes: int = 32) -> None:
        device = torch.device("cpu")
        log = torch.log(torch.tensor([LOW, HIGH]))
        friction = (log[0] + (log[1] - log[0]) * torch.rand(400)).exp()
        attributes = torch.zeros(400, 2, 4)
        attributes[..., 0] = 0.0008 * (200.0 + 600.0 * torch.rand(400, 2))  # of 20 mm half sides
        attributes[..., 1:4] = 0.02
        self._density = attributes[..., 0] / 64e-6
        attributes[..., 0] = self._density * 64e-6
        self.pack: Any = types.SimpleNamespace(
            episodes=episodes, mask=torch.ones(400, 2), device=device, world=friction[:, None],
            attributes=torch.cat([attributes, torch.ones(400, 2, 1)], dim=-1),
            layout=types.SimpleNamespace(
                attributes=("mass", "half_x", "half_y", "half_z", "type_box"),
                settings=("friction_slide",),
            ),
        )  # fmt: skip

    def draw(self, count: int) -> Truth:
        episode = torch.randint(400, (count,))
        self.speed = 0.5 + 2.0 * torch.rand(count, 2)
        self.speed[count // 2 :] = 0.0
        self.heading = 6.28 * torch.rand(count, 2)
        logs = torch.cat([self.pack.world[episode], self._density[episode]], 1).log()
        return Truth(torch.arange(count), episode, logs, torch.ones(count, 3))

    def every(self, apart: int) -> Truth:
        return self.draw(400)

    def way(self, truth: Truth) -> Tensor:
        return self.gone(truth.logs[:, 0].exp())[:, -1]

    def gone(self, friction: Tensor) -> Tensor:
        """[B, T, 2]: m from where boxes began, under friction [B]."""
        time = STEP * torch.arange(FRAMES)[None, :, None]
        slow = (GRAVITY * friction)[:, None, None]
        until = time.minimum(self.speed[:, None] / slow)
        return self.speed[:, None] * until - 0.5 * slow * until.square()

    def seen(self, truth: Truth, noisy: bool = True) -> Window:
        count = len(truth.first)
        way = self.gone(truth.logs[:, 0].exp())
        turn = torch.stack([self.heading.cos(), self.heading.sin(), 0.0 * self.heading], dim=-1)
        pos = way[..., None] * turn[:, None] + torch.tensor([[0.0, 0.0, 0.02], [0.3, 0.0, 0.02]])
        return Window(
            torch.zeros(count, FRAMES, 3) + torch.tensor([0.0, 0.0, 0.3]),
            torch.eye(3).expand(count, FRAMES, 3, 3),
            pos,
            torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(count, FRAMES, 2, 4),
            torch.ones(count, FRAMES),
            torch.ones(count, FRAMES, 2),
            torch.full((count, 2, 3), 0.02),
            torch.full((count, 2), 0.3),
            torch.ones(count, 2),
        )

    def __call__(self, truth: Truth, values: Tensor) -> tuple[Tensor, Tensor]:
        """Errors of free runs from the begin of each third, [B, 3, 21, 2, 2, 3], along x alone."""
        true, found = self.gone(truth.logs[:, 0].exp()), self.gone(values[:, 0])
        off = (found - true)[:, 1:].unflatten(1, (3, 21))
        errors = torch.zeros(*off.shape, 2, 3)
        errors[..., 0, 0] = off
        return errors, (self.speed > 0)[:, None].expand(-1, 3, -1).float()
