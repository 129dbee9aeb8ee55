"""Rotations of a box that look the same."""

from __future__ import annotations

import itertools

import torch
from torch import Tensor

_SAME = 0.02
"""Half sizes that differ by less, relative to the largest, count as equal."""


def cube_rotations() -> Tensor:
    """[24, 3, 3]: the rotations that take a cube to itself."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = torch.zeros(3, 3)
            for row, (column, sign) in enumerate(zip(order, signs, strict=True)):
                matrix[row, column] = sign
            if torch.linalg.det(matrix) > 0:
                found.append(matrix)
    return torch.stack(found)


def unlike(size: Tensor) -> Tensor:
    """[..., 24]: True where a rotation of `cube_rotations` changes a box of half sizes [..., 3]."""
    turned = (cube_rotations().to(size).abs() @ size[..., None, :, None])[..., 0]
    largest = size.amax(-1, keepdim=True)[..., None]
    return ((turned - size[..., None, :]).abs() > _SAME * largest).any(-1)


def rotation_error(found: Tensor, true: Tensor, size: Tensor) -> Tensor:
    """Squared distance [...] of rotation matrices [..., 3, 3], up to the box's symmetries."""
    candidates = true[..., None, :, :] @ cube_rotations().to(true)
    errors = (found[..., None, :, :] - candidates).square().sum((-1, -2))
    return errors.masked_fill(unlike(size), torch.inf).amin(-1)


def angle(squared: Tensor) -> Tensor:
    """The angle, rad, between rotations whose matrices have this squared distance."""
    return 2.0 * torch.asin((squared / 8.0).clamp(0, 1).sqrt())
