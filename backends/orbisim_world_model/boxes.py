"""Boxes that may touch: how far apart they are, in which direction, and where."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from orbisim_world_model.rotation import exponential, rotate_back, to_matrix

_PARALLEL = 1e-3
"""Length of the cross product of two edges below which they are taken as parallel."""
_EDGES_LATER = 1e-4
"""m, by which a crossing of edges must separate better than faces to count: where faces meet,
rounding would choose between equal directions."""
_PATCH = 0.004
"""m, width of the weights by which corners make up the middle of a contact."""
_FAR = 1e3
"""m, for directions that do not count."""


class Boxes(NamedTuple):
    """M boxes of B worlds, in the world frame.

    Attributes:
      pos: [B, M, 3], m. rot: [B, M, 3, 3]. half: [B, M, 3] half sides, m.
      vel, ang: [B, M, 3] of the centre, m/s, and rad/s.
    """

    pos: Tensor
    rot: Tensor
    half: Tensor
    vel: Tensor
    ang: Tensor

    def chosen(self, index: Tensor) -> Boxes:
        """The boxes of these numbers."""
        return Boxes(*(field.index_select(1, index) for field in self))

    def later(self, duration: float) -> Boxes:
        """Where they are after so many seconds at constant velocity."""
        turn = to_matrix(exponential(self.ang * duration))
        rot = (turn[..., :, :, None] * self.rot[..., None, :, :]).sum(-2)
        return self._replace(pos=self.pos + self.vel * duration, rot=rot)

    def speed_at(self, point: Tensor) -> Tensor:
        """Velocity [B, M, 3] of each box at a point [B, M, 3]."""
        return self.vel + torch.linalg.cross(self.ang, point - self.pos)


def separation(a: Boxes, b: Boxes) -> tuple[Tensor, Tensor]:
    """Gap [B, M] between boxes, negative where they overlap, and the direction [B, M, 3] from a.

    By the theorem of separating axes: of the three face normals of each box and the nine crossings
    of their edges, the direction that separates them most. The sign is exact, and so is the depth
    of an overlap; between boxes apart whose corners or edges are closest it is a lower bound.
    """
    offset = b.pos - a.pos
    axes_a, axes_b = a.rot.transpose(-1, -2), b.rot.transpose(-1, -2)  # rows are axes
    shape = (*offset.shape[:-1], 3, 3, 3)
    crossed = torch.linalg.cross(
        axes_a[..., :, None, :].expand(shape), axes_b[..., None, :, :].expand(shape)
    ).flatten(-3, -2)  # [B, M, 9, 3]
    square = crossed.square().sum(-1)
    usable = square > _PARALLEL**2
    length = torch.where(usable, square, torch.ones_like(square)).sqrt()
    axes = torch.cat([axes_a, axes_b, crossed / length[..., None]], dim=-2)  # [B, M, 15, 3]
    reach = _reach(a, axes) + _reach(b, axes)
    along = (axes * offset[..., None, :]).sum(-1)
    gap = along.abs() - reach
    edges = torch.where(usable, gap[..., 6:] - _EDGES_LATER, torch.full_like(square, -_FAR))
    gap = torch.cat([gap[..., :6], edges], dim=-1)
    forward = torch.where(along < 0.0, -torch.ones_like(along), torch.ones_like(along))
    gap, direction = _largest(gap, axes * forward[..., None])
    return gap, direction


def contact_point(a: Boxes, b: Boxes) -> Tensor:
    """The middle [B, M, 3] of where two boxes touch: of the corners of each in the other."""
    corners = torch.cat([_corners(a), _corners(b)], dim=-2)  # [B, M, 16, 3]
    outside = torch.cat([_outside(b, corners[..., :8, :]), _outside(a, corners[..., 8:, :])], -1)
    weight = (-outside / _PATCH**2).softmax(dim=-1)
    return (weight[..., None] * corners).sum(-2)


def _reach(box: Boxes, axes: Tensor) -> Tensor:
    """[B, M, A]: how far a box reaches from its centre along each axis."""
    along = (axes[..., :, None, :] * box.rot.transpose(-1, -2)[..., None, :, :]).sum(-1)
    return (along.abs() * box.half[..., None, :]).sum(-1)


def _largest(values: Tensor, vectors: Tensor) -> tuple[Tensor, Tensor]:
    """The largest value [..., n] and its vector [..., n, 3], without a search for its place."""
    while values.shape[-1] > 1:
        count = values.shape[-1] // 2
        one, other, spare = values[..., :count], values[..., count : 2 * count], 2 * count
        better = one > other
        best = torch.where(better, one, other)
        kept = torch.where(better[..., None], vectors[..., :count, :], vectors[..., count:spare, :])
        values = torch.cat([best, values[..., spare:]], dim=-1)
        vectors = torch.cat([kept, vectors[..., spare:, :]], dim=-2)
    return values[..., 0], vectors[..., 0, :]


def _corners(box: Boxes) -> Tensor:
    """[B, M, 8, 3]."""
    x, y, z = (box.half[..., k, None] * box.rot[..., :, k] for k in range(3))
    found = [box.pos + i * x + j * y + k * z for i in _ENDS for j in _ENDS for k in _ENDS]
    return torch.stack(found, dim=-2)


_ENDS = (-1.0, 1.0)


def _outside(box: Boxes, points: Tensor) -> Tensor:
    """[B, M, P]: squared distance of points [B, M, P, 3] from a box."""
    local = rotate_back(box.rot[..., None, :, :], points - box.pos[..., None, :])
    return (local.abs() - box.half[..., None, :]).clamp(min=0.0).square().sum(-1)
