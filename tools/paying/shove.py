"""A gripper that shoves a box which slides farther than its scene says."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from orbisim_policies.problem import Floats, Moment, Starts
from torch import Tensor

from orbisim.effects import EffectInstance
from paying.duty import Duty, span

STRIDE = 0.05
"""m: the commanded hand moves so far in a control step, 1 m/s."""
NEAR = 0.015
"""m: a box as near as that is in its place."""
_REACH = (-0.1, 0.6)
"""Where the hand is commanded to be, m."""
_CENTRE = {"com_x": 0.0, "com_y": 0.0, "com_z": 0.0}


class Shove(Duty):
    """The box is to end at a place; there is no way to pull it back."""

    name, asset = "loop:gripper_push", "gripper_push"
    timestep, steps, actions = 0.05, 30, 1
    observations = 9
    unit, scale = "mm", 1e3
    goal = f"box within {1e3 * NEAR:.0f} mm of its place after 1.5 s"
    effects = (EffectInstance("sliding_friction", "box", {"coefficient": 0.25}),)
    wide = (
        span("sliding_friction", "box", 0.1, 1.2),
        span("payload", "box", -0.15, 0.15, **_CENTRE),
        span("torque_gain", "x", 0.7, 1.3),
        span("coulomb_friction", "x", 0.0, 2.0),
    )

    def start(self, rng: np.random.Generator) -> tuple[Sequence[float], Sequence[float], Floats]:
        """The box up to 3 cm from the hand, its place 15 to 35 cm on; the command is the hand's."""
        x = 0.12 + rng.uniform(0.0, 0.03)
        qpos = [0.0, 0.0, x, rng.uniform(-0.005, 0.005), 0.04189, 1.0, 0.0, 0.0, 0.0]
        return qpos, [0.0] * 8, np.array([0.0, x + rng.uniform(0.15, 0.35)])

    def reward(self, memory: Tensor, q: Tensor, v: Tensor, control: Tensor) -> Tensor:
        """Near, coarsely and finely."""
        away = (q[:, 2] - memory[:, 1]).abs()
        return 0.5 * (-away / 0.1).exp() + 0.5 * (-(away / NEAR).square()).exp()

    def see(self, q: Tensor, v: Tensor, moment: Moment) -> Tensor:
        """Hand, box and place along the way, speeds, and the time."""
        command = moment.command.to(q)
        left = command[:, 1] - q[:, 2]
        parts = [
            (q[:, 0] - 0.25) / 0.2,
            (command[:, 0] - q[:, 0]) / 0.05,
            v[:, 0] / 0.5,
            (q[:, 2] - q[:, 0] - 0.06) / 0.03,
            v[:, 2] / 0.5,
            left / 0.2,
            (left / 0.03).clamp(-2, 2),
            (command[:, 1] - 0.4) / 0.1,
            moment.time,
        ]
        return torch.stack(parts, 1)

    def control(self, command: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Where the servo of the way is to go; the other stays."""
        where = (command[:, :1] + STRIDE * action.clamp(-1, 1)).clamp(*_REACH)
        after = torch.cat([where, command[:, 1:]], 1)
        return torch.cat([where, torch.zeros_like(where)], 1), after

    def miss(self, starts: Starts, q: Tensor, value: Tensor) -> Tensor:
        """Distance of the box from its place along the way, m."""
        return (q[:, 2] - torch.as_tensor(starts.command)[:, 1]).abs()

    def good(self, q: Tensor, miss: Tensor) -> Tensor:
        """In its place, and on the table (a box that has tipped over is not)."""
        return (miss < NEAR) & ((q[:, 4] - 0.042).abs() < 0.005)
