"""A leg on a rail whose knee has play in its gear."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from orbisim_policies.problem import Floats, Moment, Starts
from torch import Tensor

from orbisim.effects import EffectInstance
from paying.duty import Duty, span

LINK, FOOT, STANDING = 0.20, 0.02, 0.42
"""Length of thigh and shank, radius of the foot, height of the hip where the rail reads 0, m."""
STRIDE, _BENT = 0.3, (0.15, 2.2)
"""rad: the commanded knee moves so far in a control step, 15 rad/s, and how far it is bent."""
NEAR = 0.01
"""m: a hop as high as asked for, so far."""


class Hop(Duty):
    """One hop from a squat, so high as asked for.

    The policy sees what the servos say and the time; the rail has no encoder that it could read.
    """

    name, asset = "loop:leg", "leg"
    timestep, steps, actions = 0.02, 30, 1
    observations = 8
    columns = (5, 6)
    unit, scale = "mm", 1e3
    goal = f"highest point of the hip within {1e3 * NEAR:.0f} mm of that asked for, in 0.6 s"
    effects = (EffectInstance("backlash", "knee", {"width": 0.1}),)
    wide = (
        span("backlash", "knee", 0.002, 0.2),
        span("torque_gain", "hip", 0.7, 1.3),
        span("torque_gain", "knee", 0.7, 1.3),
        span("coulomb_friction", "rail", 0.0, 2.0),
    )

    def start(self, rng: np.random.Generator) -> tuple[Sequence[float], Sequence[float], Floats]:
        """A squat on the floor; the command is the knee's and the height asked for."""
        knee = rng.uniform(1.45, 1.55)
        hip = -knee / 2
        rail = LINK * (np.cos(hip) + np.cos(hip + knee)) + FOOT - STANDING
        command = np.array([knee, rng.uniform(0.03, 0.09)])
        return [rail, hip, knee], [0.0] * 3, command

    def begin(self, qpos: Tensor, qvel: Tensor, command: Tensor) -> Tensor:
        """[N, 2]: the highest point so far and the one asked for, m."""
        return torch.stack([qpos[:, self.q[0]], command[:, 1].to(qpos)], 1)

    def count(self, score: Tensor, qpos: Tensor, qvel: Tensor, control: Tensor) -> Tensor:
        """The highest point."""
        return torch.stack([torch.maximum(score[:, 0], qpos[:, self.q[0]]), score[:, 1]], 1)

    def value(self, score: Tensor, qpos: Tensor) -> Tensor:
        """[N, 1]: how near the highest point is to the one asked for, coarsely and finely."""
        return _worth((score[:, 0] - score[:, 1]).abs())[:, None]

    def reward(self, memory: Tensor, q: Tensor, v: Tensor, control: Tensor) -> Tensor:
        """None at a step: `value` says what an episode is worth."""
        return torch.zeros_like(q[:, 0])

    def see(self, q: Tensor, v: Tensor, moment: Moment) -> Tensor:
        """Hip and knee, their speeds, what is left to go, the height asked for, and the time."""
        command = moment.command.to(q)
        asked = (command[:, 1:] - 0.06) / 0.03
        joints = torch.stack([q[:, 1] / 0.6, q[:, 2] - 1.0], 1)
        speeds, time = v[:, 1:3] / 10, moment.time[:, None]
        return torch.cat(
            [joints, speeds, 2 * (command[:, :1] - q[:, 2:]), asked, time, time.square()], 1
        )

    def control(self, command: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Where the servos are to go: the knee from 0.15 to 2.2, the hip half as far back."""
        knee = (command[:, :1] + STRIDE * action.clamp(-1, 1)).clamp(*_BENT)
        return torch.cat([-knee / 2, knee], 1), torch.cat([knee, command[:, 1:]], 1)

    def miss(self, starts: Starts, q: Tensor, value: Tensor) -> Tensor:
        """How far the highest point was from the one asked for, m.

        From the value, which falls with it: the end of an episode says nothing of a hop.
        """
        low, high = torch.zeros_like(value[:, 0]), torch.ones_like(value[:, 0])
        for _ in range(40):  # halvings: far below what is reported
            middle = (low + high) / 2
            above = _worth(middle) > value[:, 0]
            low, high = torch.where(above, middle, low), torch.where(above, high, middle)
        return (low + high) / 2

    def good(self, q: Tensor, miss: Tensor) -> Tensor:
        """As high as asked for."""
        return miss < NEAR


def _worth(away: Tensor) -> Tensor:
    """Falls evenly over 0.3 m, farther than any hop is off, and steeply near 0."""
    return 0.5 * (1 - away / 0.3) + 0.5 * (-(away / NEAR).square()).exp()
