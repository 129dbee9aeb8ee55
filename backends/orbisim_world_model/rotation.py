"""Rotations as torch tensors: unit quaternions (w, x, y, z), matrices, rotation vectors."""

from __future__ import annotations

import torch
from torch import Tensor

_TINY = 1e-12
"""Keeps square roots differentiable at zero; its own root, 1e-6 rad, is below what float32 tells
apart."""


def normalized(quat: Tensor) -> Tensor:
    """Unit quaternions [..., 4]."""
    return quat / quat.square().sum(-1, keepdim=True).clamp_min(_TINY).sqrt()


def multiply(a: Tensor, b: Tensor) -> Tensor:
    """Quaternion product a * b, each [..., 4]."""
    aw, av = a[..., :1], a[..., 1:]
    bw, bv = b[..., :1], b[..., 1:]
    real = aw * bw - (av * bv).sum(-1, keepdim=True)
    return torch.cat([real, aw * bv + bw * av + torch.linalg.cross(av, bv)], dim=-1)


def exponential(vector: Tensor) -> Tensor:
    """Unit quaternions of rotation vectors [..., 3] (axis times angle)."""
    half = 0.5 * vector.square().sum(-1, keepdim=True).add(_TINY).sqrt()
    return torch.cat([half.cos(), 0.5 * vector * (half.sin() / half)], dim=-1)


def logarithm(quat: Tensor) -> Tensor:
    """Rotation vectors [..., 3] of unit quaternions, of length at most pi."""
    quat = torch.where(quat[..., :1] < 0, -quat, quat)
    length = quat[..., 1:].square().sum(-1, keepdim=True).add(_TINY).sqrt()
    return quat[..., 1:] * (2.0 * torch.atan2(length, quat[..., :1]) / length)


def conjugate(quat: Tensor) -> Tensor:
    """Inverse of unit quaternions [..., 4]."""
    return torch.cat([quat[..., :1], -quat[..., 1:]], dim=-1)


def to_matrix(quat: Tensor) -> Tensor:
    """Rotation matrices [..., 3, 3] of unit quaternions [..., 4]."""
    w, x, y, z = quat.unbind(-1)
    xx, yy, zz = 2 * x * x, 2 * y * y, 2 * z * z
    xy, xz, yz, wx, wy, wz = 2 * x * y, 2 * x * z, 2 * y * z, 2 * w * x, 2 * w * y, 2 * w * z
    flat = [1 - yy - zz, xy - wz, xz + wy, xy + wz, 1 - xx - zz, yz - wx]
    flat += [xz - wy, yz + wx, 1 - xx - yy]
    return torch.stack(flat, dim=-1).unflatten(-1, (3, 3))


def orthonormalized(matrix: Tensor) -> Tensor:
    """The rotation [..., 3, 3] that Gram and Schmidt make of the first two columns."""
    x = matrix[..., :, 0]
    x = x / x.square().sum(-1, keepdim=True).clamp_min(_TINY).sqrt()
    y = matrix[..., :, 1] - (x * matrix[..., :, 1]).sum(-1, keepdim=True) * x
    y = y / y.square().sum(-1, keepdim=True).clamp_min(_TINY).sqrt()
    return torch.stack([x, y, torch.linalg.cross(x, y)], dim=-1)


def geodesic_distance(a: Tensor, b: Tensor) -> Tensor:
    """Angle [...] between rotation matrices [..., 3, 3], rad; its gradient stays finite.

    The arc cosine of the trace has no derivative where the matrices agree; the angle is taken from
    the length of a - b instead, which is 2 sqrt(2) sin(angle / 2).
    """
    chord = (a - b).square().sum((-1, -2)).add(_TINY).sqrt() / 8.0**0.5
    return 2.0 * torch.asin(chord.clamp(max=1.0 - 1e-6))


def quaternion_distance(a: Tensor, b: Tensor) -> Tensor:
    """1 - <a, b>^2 of the normalised quaternions [..., 4]; 0 where they are the same rotation."""
    return 1.0 - (normalized(a) * normalized(b)).sum(-1).square()


def product(a: Tensor, b: Tensor) -> Tensor:
    """Matrix product of small matrices [..., n, n].

    By multiplication and summation, since a GPU's matrix units may round to ten bits.
    """
    return (a[..., :, :, None] * b[..., None, :, :]).sum(-2)


def rotate(matrix: Tensor, vector: Tensor) -> Tensor:
    """Matrix [..., 3, 3] times vector [..., 3]."""
    return (matrix * vector[..., None, :]).sum(-1)


def rotate_back(matrix: Tensor, vector: Tensor) -> Tensor:
    """Transposed matrix [..., 3, 3] times vector [..., 3]."""
    return (matrix * vector[..., :, None]).sum(-2)
