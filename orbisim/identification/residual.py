"""Errors of simulated positions, in units of typical ones, as torch tensors."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import torch
from torch import Tensor

from orbisim.identification.parameters import KINDS, Parameter
from orbisim.identification.windows import JOINT, PLACE, TURN, places


def errors(found: Tensor, target: Tensor, joints: Sequence[int], bodies: Sequence[int]) -> Tensor:
    """[W, R] of positions [W, T, nq]; 0 where nothing was recorded, NaN where a rollout diverged.

    Args:
      joints, bodies: addresses of the coordinates that count.
    """
    parts, known = [], []
    if joints:
        where = list(joints)
        parts.append((found[..., where] - target[..., where]) / JOINT)
        known.append(torch.isfinite(target[..., where]))
    for first in bodies:
        parts.append((found[..., first : first + 3] - target[..., first : first + 3]) / PLACE)
        turn = _turn(found[..., first + 3 : first + 7], target[..., first + 3 : first + 7])
        parts.append(turn / TURN)
        turned = torch.isfinite(target[..., first + 3 : first + 7]).all(-1, keepdim=True)
        known += [torch.isfinite(target[..., first : first + 3]), turned.expand_as(turn)]
    every = torch.cat(parts, dim=-1)
    return torch.where(torch.cat(known, dim=-1), every, torch.zeros_like(every)).flatten(1)


def counted(model: mujoco.MjModel, parameters: Sequence[Parameter]) -> tuple[list[int], list[int]]:
    """Addresses of joints and free bodies whose errors count.

    Joints do where a parameter is of a joint, or where there is nothing else: a servo's own errors
    say nothing of what the hand touches.
    """
    joints, bodies = places(model)
    of_joint = any(KINDS[parameter.name].of_joint for parameter in parameters)
    return (joints if of_joint or not bodies else []), bodies


def _turn(a: Tensor, b: Tensor) -> Tensor:
    """Twice the vector part of a b^-1, [..., 3], rad for small turns; the sign of b is free."""
    b = b / b.square().sum(-1, keepdim=True).sqrt()
    real = (a * b).sum(-1, keepdim=True)
    vector = b[..., :1] * a[..., 1:] - a[..., :1] * b[..., 1:]
    vector = vector - torch.linalg.cross(a[..., 1:], b[..., 1:])
    return 2.0 * vector * torch.where(real < 0, -1.0, 1.0)
