"""The physical state as the model sees it: one robot and N objects, in torch tensors.

Shapes: B worlds, J scalar joints, A activations, N objects, D attributes, W world settings.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Entities(NamedTuple):
    """x_t: the states of the robot and of the objects.

    Attributes:
      q, v: [B, J] joint positions and velocities of the robot, rad or m.
      act: [B, A] actuator activations.
      hand: [B, 18] or [B, 0]: the hand's position 3, rotation matrix 9 (by rows), linear
        velocity 3 and angular velocity 3, in the world frame.
      pos, quat, vel, ang: [B, N, 3 | 4 | 3 | 3] of the objects, in the world frame.
    """

    q: Tensor
    v: Tensor
    act: Tensor
    hand: Tensor
    pos: Tensor
    quat: Tensor
    vel: Tensor
    ang: Tensor

    @property
    def hand_pos(self) -> Tensor:
        """[B, 3]."""
        return self.hand[..., :3]

    @property
    def hand_rot(self) -> Tensor:
        """[B, 3, 3]."""
        return self.hand[..., 3:12].unflatten(-1, (3, 3))

    @property
    def hand_vel(self) -> Tensor:
        """[B, 3]."""
        return self.hand[..., 12:15]

    @property
    def hand_ang(self) -> Tensor:
        """[B, 3]."""
        return self.hand[..., 15:18]

    def at(self, index: Tensor | int | slice) -> Entities:
        """The same fields at an index of the leading axis."""
        return Entities(*(field[index] for field in self))

    def to(self, *args: object) -> Entities:
        """Every field moved or converted, as `Tensor.to`."""
        return Entities(*(field.to(*args) for field in self))

    def detach(self) -> Entities:
        """Without gradients."""
        return Entities(*(field.detach() for field in self))


class Hand(NamedTuple):
    """The robot's hand in the world frame.

    Attributes:
      pos: [B, 3], m. rot: [B, 3, 3]. vel: [B, 3], m/s. ang: [B, 3], rad/s.
    """

    pos: Tensor
    rot: Tensor
    vel: Tensor
    ang: Tensor


class Context(NamedTuple):
    """The static descriptors of each world.

    Attributes:
      attributes: [B, N, D] of the objects.
      world: [B, W].
      mask: [B, N], 1 where there is an object and 0 where there is padding; None for all ones.
      parts: [B, P, D] of the parts of mechanisms (`parts.COLUMNS`); None without.
      part_mask: [B, P], as `mask`; None for all ones.
      scales: what follows from attributes and world alone, if it was computed beforehand (see
        `Dynamics.described`).
    """

    attributes: Tensor
    world: Tensor
    mask: Tensor | None
    parts: Tensor | None = None
    part_mask: Tensor | None = None
    scales: Tensor | None = None


def choose(condition: Tensor, a: Entities, b: Entities) -> Entities:
    """World by world [B]: `a` where the condition holds, else `b`."""

    def pick(x: Tensor, y: Tensor) -> Tensor:
        return torch.where(condition.reshape(-1, *([1] * (x.dim() - 1))), x, y)

    return Entities(*map(pick, a, b))
