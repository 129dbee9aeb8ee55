"""An arm of two links that carries a load it does not know of, with friction in a joint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from orbisim_policies.problem import Floats, Moment, Starts
from torch import Tensor

from orbisim.effects import EffectInstance
from paying.duty import Duty, span

UPPER, FORE = 0.30, 0.25
"""Lengths of the links, m."""
TORQUES = (5.0, 1.5)
"""N m, of the motors."""
NEAR = 0.015
"""m: a hand as near as that has reached the goal."""
_END = {"com_x": 0.0, "com_y": 0.0, "com_z": -FORE}


def hand(q: Tensor) -> Tensor:
    """x and z of the end of the forearm, [N, 2] m."""
    first, second = q[:, 0], q[:, 0] + q[:, 1]
    x = -UPPER * first.sin() - FORE * second.sin()
    return torch.stack([x, -UPPER * first.cos() - FORE * second.cos()], 1)


class Reach(Duty):
    """The hand is to come to a point and stay there."""

    name, asset = "loop:arm2", "arm2"
    timestep, steps, actions = 0.02, 100, 2
    observations = 12
    unit, scale = "mm", 1e3
    goal = f"hand within {1e3 * NEAR:.0f} mm of a point after 2 s"
    effects = (
        EffectInstance("payload", "forearm", {"mass": 0.2, **_END}),
        EffectInstance("coulomb_friction", "elbow", {"torque": 0.2}),
    )
    wide = (
        span("payload", "forearm", 0.0, 0.4, **_END),
        span("coulomb_friction", "shoulder", 0.0, 0.4),
        span("coulomb_friction", "elbow", 0.0, 0.4),
        span("torque_gain", "shoulder", 0.7, 1.3),
        span("torque_gain", "elbow", 0.7, 1.3),
    )

    def start(self, rng: np.random.Generator) -> tuple[Sequence[float], Sequence[float], Floats]:
        """Hanging, up to 0.3 rad off; the goal is where some pose has its hand."""
        pose = torch.tensor([[rng.uniform(-0.8, 0.8), rng.uniform(0.3, 1.4)]])
        return rng.uniform(-0.3, 0.3, 2).tolist(), [0.0, 0.0], hand(pose)[0].double().numpy()

    def reward(self, memory: Tensor, q: Tensor, v: Tensor, control: Tensor) -> Tensor:
        """Near, coarsely and finely."""
        away = (hand(q) - memory).norm(dim=1)
        coarse, fine = (-away / 0.2).exp(), (-(away / NEAR).square()).exp()
        return 0.5 * coarse + 0.5 * fine - 0.002 * v.square().sum(1).clamp(max=50.0)

    def see(self, q: Tensor, v: Tensor, moment: Moment) -> Tensor:
        """Joints, speeds, the goal, and the way there coarsely and finely."""
        goal = moment.command.to(q)
        way = goal - hand(q)
        fine = (way / 0.03).clamp(-2, 2)
        return torch.cat([q.cos(), q.sin(), v / 4, goal / 0.3, way / 0.2, fine], 1)

    def control(self, command: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Torques."""
        return action.clamp(-1, 1) * torch.tensor(TORQUES), command

    def miss(self, starts: Starts, q: Tensor, value: Tensor) -> Tensor:
        """Distance of the hand from the goal, m."""
        return (hand(q) - torch.as_tensor(starts.command)).norm(dim=1)

    def good(self, q: Tensor, miss: Tensor) -> Tensor:
        """Near enough."""
        return miss < NEAR
