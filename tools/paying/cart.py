"""Cart and pole whose rail has Coulomb friction and whose motor is late."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from orbisim_policies.problem import Floats, Moment, Starts
from torch import Tensor

from orbisim.effects import EffectInstance
from paying.duty import Duty, span

MOST = 8.0
"""N, of the motor."""
_HISTORY = 8
"""Last actions that a policy sees: more than twice the machine's delay."""
_CART, _POLE = (
    {"com_x": 0.0, "com_y": 0.0, "com_z": 0.0},
    {"com_x": 0.0, "com_y": 0.0, "com_z": -0.3},
)
"""Centres of mass of cart and pole, where masses are drawn."""


class Balance(Duty):
    """The pole is to stay up, the cart near the middle."""

    name, asset = "loop:cart_pole", "cart_pole"
    timestep, steps, actions = 0.02, 250, 1
    observations = 5 + _HISTORY
    unit, scale = "deg", 180 / np.pi
    goal = "pole within 0.2 rad of upright, cart within 1 m of the middle after 5 s"
    effects = (
        EffectInstance("coulomb_friction", "cart", {"torque": 1.0}),
        EffectInstance("actuator_delay", "push", {"delay": 0.08}),
    )
    wide = (
        span("coulomb_friction", "cart", 0.0, 4.0),
        span("actuator_delay", "push", 0.0, 0.14),
        span("torque_gain", "push", 0.7, 1.3),
        span("payload", "cart", -0.3, 0.3, **_CART),
        span("payload", "pole", -0.075, 0.075, **_POLE),
    )

    def start(self, rng: np.random.Generator) -> tuple[Sequence[float], Sequence[float], Floats]:
        """The pole up to 0.15 rad off."""
        qpos = [rng.uniform(-0.1, 0.1), np.pi + rng.uniform(-0.15, 0.15)]
        return qpos, rng.uniform(-0.1, 0.1, 2).tolist(), np.zeros(_HISTORY)

    def reward(self, memory: Tensor, q: Tensor, v: Tensor, control: Tensor) -> Tensor:
        """Up, near the middle, with little force."""
        up = (1 - q[:, 1].cos()) / 2
        middle = (-(q[:, 0] / 0.7).square()).exp()
        return up.square() * (1 + middle) / 2 - 0.02 * (control[:, 0] / MOST).square()

    def see(self, q: Tensor, v: Tensor, moment: Moment) -> Tensor:
        """Cart, pole, speeds and the last actions."""
        angle = torch.stack([q[:, 1].cos(), 3 * q[:, 1].sin()], 1)
        return torch.cat([q[:, :1], angle, v / 2, moment.command], 1)

    def control(self, command: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """The motor's force; the last actions are remembered."""
        action = action.clamp(-1, 1)
        return MOST * action, torch.cat([action, command[:, :-1]], 1)

    def miss(self, starts: Starts, q: Tensor, value: Tensor) -> Tensor:
        """Angle from upright, rad."""
        return (torch.remainder(q[:, 1], 2 * np.pi) - np.pi).abs()

    def good(self, q: Tensor, miss: Tensor) -> Tensor:
        """Up, and the cart not far away."""
        return (miss < 0.2) & (q[:, 0].abs() < 1.0)
