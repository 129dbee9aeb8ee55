"""What the networks of a cloth see: velocities, edges, and what is near, as vectors and numbers."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from orbisim_world_model.cloth.mesh import Cloth, Mesh
from orbisim_world_model.cloth.solids import Near

_NEAR, _TOUCH = 0.05, 0.01
"""m: ranges of the two functions of distance: about an edge's length, and about a step's motion
and the thickness of the cloth."""
_SPEED = 1.0
"""m/s: of a cloth that falls by some centimetres."""
_STIFF = 10.0
"""Strains of cloths that hardly stretch are hundredths."""
_SHORT = 1e-6  # m: edges below it have no direction
NODE, EDGE = 20, 14
"""Numbers of a vertex and of an edge."""


class Seen(NamedTuple):
    """Features.

    Attributes:
      node: of vertices [B, V, NODE]. edge: of edges as a vertex' own [B, V, N, EDGE].
      real: [V, N, 1], which of these there are.
      company: [B, 1, 1], 1 where the cloth touches something, fading with the distance of the
        nearest thing.
    """

    node: Tensor
    edge: Tensor
    real: Tensor
    company: Tensor


class _Around(NamedTuple):
    """Of each vertex and its edges [B, V, N, ...], zero where there is no edge [V, N].

    Attributes:
      away, drift: to the other end, m, and its velocity in units of `_SPEED`. length: m.
      strain: of the edge. rest: its length at rest, m. real: 1 where there is an edge.
      size: mean length of edges at rest, m.
    """

    away: Tensor
    drift: Tensor
    length: Tensor
    strain: Tensor
    rest: Tensor
    real: Tensor
    size: Tensor


def features(mesh: Mesh, x: Cloth, near: Near, turn: Tensor | None = None) -> Seen:
    """What is seen of a cloth.

    Args:
      mesh: at rest. x: [B, V, 3]. near: of vertices and edges' middles [B, V + E].
      turn: [B, 3, 3] in which frame directions are given; the world's if None.
    """
    around, (close, touch, normal) = _around(mesh, x), _proximity(near, mesh.radius)
    count = mesh.vertices
    told = torch.cat([close, touch, normal], dim=-1)
    distance = (near.distance[:, :count, None] / _NEAR).clamp(-1, 4)
    node = torch.cat([_of_vertices(x, around, told[:, :count], turn), distance], dim=-1)
    none = torch.zeros_like(told[:, :1])
    edge = _of_edges(around, torch.cat([told[:, count:], none], dim=1)[:, mesh.along], turn)
    real = around.real[..., None]
    return Seen(node, edge * real, real, close.amax(1, keepdim=True).clamp(max=1.0))


def _around(mesh: Mesh, x: Cloth) -> _Around:
    real = (mesh.along < len(mesh.rest)).to(x.pos.dtype)
    rest = torch.cat([mesh.rest, mesh.rest.new_ones(1)])[mesh.along]
    away = (x.pos[:, mesh.neighbour] - x.pos[:, :, None]) * real[..., None]
    drift = (x.vel[:, mesh.neighbour] - x.vel[:, :, None]) * real[..., None] / _SPEED
    length = away.norm(dim=-1)
    strain = (length / rest - 1.0) * real
    return _Around(away, drift, length, strain, rest, real, mesh.rest.mean())


def _of_vertices(x: Cloth, around: _Around, told: Tensor, turn: Tensor | None) -> Tensor:
    """Velocity, what is near [B, V, 5], and what a vertex' edges do on the whole."""
    away, degree = around.away, around.real.sum(-1)
    along = away / around.length.clamp_min(_SHORT)[..., None]
    pull = (around.strain[..., None] * along).sum(2) * _STIFF
    bend = away.sum(2) / degree[:, None] / around.size
    lag = around.drift.sum(2) / degree[:, None]
    normal = told[..., 2:]
    vectors = torch.stack([x.vel / _SPEED, normal, pull, bend, lag], dim=-2)
    approach = (x.vel * normal).sum(-1, keepdim=True) / _SPEED
    free = (1 - degree / degree.max())[:, None].expand(*x.pos.shape[:2], 1)
    return torch.cat([_turned(vectors, turn).flatten(-2), told[..., :2], approach, free], dim=-1)


def _of_edges(around: _Around, middle: Tensor, turn: Tensor | None) -> Tensor:
    """Where the other end is, and what is near the edge's middle [B, V, N, 5]."""
    vectors = torch.stack([around.away / around.size, around.drift, middle[..., 2:]], dim=-2)
    longer = (around.rest / around.size - 1).expand(around.strain.shape)
    numbers = torch.stack([around.strain * _STIFF, longer], dim=-1)
    size = (around.length / around.size)[..., None]
    return torch.cat([_turned(vectors, turn).flatten(-2), numbers, middle[..., :2], size], dim=-1)


def _proximity(near: Near, radius: float) -> tuple[Tensor, Tensor, Tensor]:
    """Two falling functions of distance [B, N, 1], and the normal where something is near."""
    gap = (near.distance - radius)[..., None]
    close = torch.exp(-gap.clamp_min(-_NEAR) / _NEAR)
    touch = torch.sigmoid(-gap / (_TOUCH / 4))
    return close, touch, near.normal * close


def _turned(vectors: Tensor, turn: Tensor | None) -> Tensor:
    """Vectors [B, ..., 3] in another frame."""
    if turn is None:
        return vectors
    shape = vectors.shape
    return (vectors.reshape(shape[0], -1, 3) @ turn).reshape(shape)
