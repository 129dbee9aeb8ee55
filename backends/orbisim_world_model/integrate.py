"""From the decoder's numbers to the next state, and back from two states to the numbers.

The numbers are in units of `Scales`, which makes them of order one in the data.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from orbisim_world_model.config import ModelConfig
from orbisim_world_model.entities import Entities
from orbisim_world_model.layout import Layout
from orbisim_world_model.rotation import (
    conjugate,
    exponential,
    logarithm,
    multiply,
    normalized,
    orthonormalized,
    rotate,
    rotate_back,
    to_matrix,
)

OBJECT_OUTPUTS = 13
"""Position 3, orientation 4 (3 on the manifold), linear velocity 3, angular velocity 3."""


def robot_outputs(layout: Layout, config: ModelConfig) -> int:
    """How many numbers the decoder gives for the robot."""
    return 2 * len(layout.robot_joints) + layout.na if config.extended else 15


class Raw(NamedTuple):
    """The decoder's numbers: robot [B, R], parts of mechanisms among its joints, and objects
    [B, N, 13]."""

    robot: Tensor
    objects: Tensor


def advance(x: Entities, raw: Raw, dt: float, config: ModelConfig) -> Entities:
    """x_t from x_{t-1} and the decoder's (unscaled) numbers.

    Args:
      x: where to start from; with `dt` 0 a prediction to be corrected.
      raw: the numbers.
      dt: the control step, s.
      config: says what the numbers mean.
    """
    pos, quat, vel, ang = _objects(x, raw.objects, dt, config)
    if not config.extended:
        return x._replace(hand=_hand(x, raw.robot, config), pos=pos, quat=quat, vel=vel, ang=ang)
    count = x.q.shape[1]
    dq, dv = raw.robot[:, :count], raw.robot[:, count : 2 * count]
    act = raw.robot[:, 2 * count :]
    if config.residual:
        v = x.v + dv
        q = x.q + 0.5 * dt * (x.v + v) + dq
        act = x.act + act
    else:
        q, v = dq, dv
    return Entities(q, v, act, x.hand, pos, quat, vel, ang)


def _objects(
    x: Entities, raw: Tensor, dt: float, config: ModelConfig
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    dpos, dquat, dvel, dang = raw.split((3, 4, 3, 3), dim=-1)
    if not config.residual:
        ang = dang if config.extended else x.ang
        return dpos, normalized(dquat), dvel, ang
    turn = dquat[..., :3]
    if config.relative:
        rot = to_matrix(x.quat)
        dpos, turn, dvel, dang = (rotate(rot, d) for d in (dpos, turn, dvel, dang))
    vel = x.vel + dvel
    pos = x.pos + 0.5 * dt * (x.vel + vel) + dpos
    if not config.extended:
        return pos, _turned(x.quat, turn, dquat, config), vel, x.ang
    ang = x.ang + dang
    return pos, _turned(x.quat, turn + 0.5 * dt * (x.ang + ang), dquat, config), vel, ang


def _turned(quat: Tensor, turn: Tensor, dquat: Tensor, config: ModelConfig) -> Tensor:
    if config.manifold:
        return normalized(multiply(exponential(turn), quat))
    return normalized(quat + dquat)


def _hand(x: Entities, raw: Tensor, config: ModelConfig) -> Tensor:
    """The paper's robot state: position, rotation matrix and linear velocity of the hand."""
    pos, rot, vel = raw[:, :3], raw[:, 3:12], raw[:, 12:15]
    if config.residual:
        pos, rot, vel = pos + x.hand[:, :3], rot + x.hand[:, 3:12], vel + x.hand[:, 12:15]
    turned = orthonormalized(rot.unflatten(-1, (3, 3))).flatten(1)
    return torch.cat([pos, turned, vel, x.hand[:, 15:18]], dim=1)


def required(x: Entities, after: Entities, dt: float, config: ModelConfig) -> Raw:
    """The numbers with which `advance` leads from `x` to `after`."""
    if not config.residual:
        objects = torch.cat([after.pos, after.quat, after.vel, after.ang], dim=-1)
        plain = torch.cat([after.q, after.v, after.act], dim=-1)
        return Raw(plain if config.extended else after.hand[:, :15], objects)
    dvel, dang = after.vel - x.vel, after.ang - x.ang
    dpos = after.pos - x.pos - 0.5 * dt * (x.vel + after.vel)
    turn = logarithm(multiply(after.quat, conjugate(x.quat)))
    if config.extended:
        turn = turn - 0.5 * dt * (x.ang + after.ang)
    if config.relative:
        rot = to_matrix(x.quat)
        dpos, turn, dvel, dang = (rotate_back(rot, d) for d in (dpos, turn, dvel, dang))
    if config.manifold:
        dquat = torch.cat([turn, torch.zeros_like(turn[..., :1])], dim=-1)
    else:
        sign = (after.quat * x.quat).sum(-1, keepdim=True).sign()
        dquat = after.quat * sign - x.quat
    objects = torch.cat([dpos, dquat, dvel, dang], dim=-1)
    if not config.extended:
        return Raw(after.hand[:, :15] - x.hand[:, :15], objects)
    dq = after.q - x.q - 0.5 * dt * (x.v + after.v)
    return Raw(torch.cat([dq, after.v - x.v, after.act - x.act], dim=-1), objects)
