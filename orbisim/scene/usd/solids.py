"""Triangle meshes of simple solids, and what there is to know about a mesh."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from orbisim.scene.usd.flat import FloatArray, IntArray

_SEGMENTS = 64
"""Corners of a circle: its edge is off by 0.1 % of the radius."""
_AREA = math.sqrt(2 * math.pi / _SEGMENTS / math.sin(2 * math.pi / _SEGMENTS))
"""Factor on the radius that gives a regular polygon the area of the circle."""


@dataclasses.dataclass(frozen=True)
class Solid:
    """A triangle mesh.

    Attributes:
      points: [n, 3].
      triangles: [m, 3], counter-clockwise from outside.
    """

    points: FloatArray
    triangles: IntArray

    def stretched(self, stretch: FloatArray) -> Solid:
        """The mesh under a linear map [3, 3]; a mirroring one turns the faces around."""
        triangles = self.triangles[:, ::-1] if np.linalg.det(stretch) < 0 else self.triangles
        return Solid(self.points @ stretch.T, np.ascontiguousarray(triangles))

    def trimmed(self) -> Solid:
        """The mesh without the points that no triangle uses."""
        used, triangles = np.unique(self.triangles, return_inverse=True)
        if len(used) == len(self.points):
            return self
        return Solid(self.points[used], triangles.reshape(-1, 3).astype(np.int32))

    @property
    def volume(self) -> float:
        """Enclosed volume; meaningful for closed meshes."""
        a, b, c = (self.points[self.triangles[:, i]] for i in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6

    def is_closed(self) -> bool:
        """Whether every edge joins two triangles that wind the same way."""
        _, welded = np.unique(self.points, axis=0, return_inverse=True)
        corners = welded.ravel()[self.triangles]
        edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
        edges = edges[edges[:, 0] != edges[:, 1]].astype(np.int64)
        count = len(self.points) + 1
        forward = np.sort(edges[:, 0] * count + edges[:, 1])
        backward = np.sort(edges[:, 1] * count + edges[:, 0])
        return bool(len(forward) and np.array_equal(forward, backward))

    def flatness(self) -> float:
        """Smallest extent over largest, along the principal directions."""
        spread = np.linalg.svd(self.points - self.points.mean(axis=0), compute_uv=False)
        return float(spread[-1] / spread[0]) if len(spread) == 3 and spread[0] > 0 else 0.0


def box(half: FloatArray) -> Solid:
    """A box with half sides [3]."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    triangles = [[q[0], q[i], q[i + 1]] for q in quads for i in (1, 2)]
    return Solid(signs * half, np.array(triangles, np.int32))


def revolved(rings: list[tuple[float, float]]) -> Solid:
    """A convex solid of revolution about z from rings (height, radius), lowest first.

    Round cross-sections become polygons of the same area; a ring of radius 0 is a tip.
    """
    angles = np.arange(_SEGMENTS) * (2 * math.pi / _SEGMENTS)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1) * _AREA
    points = [
        np.concatenate([circle * radius, np.full((_SEGMENTS, 1), height)], axis=1)
        for height, radius in rings
    ]
    bottom, top = _SEGMENTS * len(rings), _SEGMENTS * len(rings) + 1
    tips = np.array([[0, 0, rings[0][0]], [0, 0, rings[-1][0]]])
    i = np.arange(_SEGMENTS)
    j = (i + 1) % _SEGMENTS
    triangles = [np.stack([np.full(_SEGMENTS, bottom), j, i], axis=1)]
    for ring in range(len(rings) - 1):
        low, high = ring * _SEGMENTS, (ring + 1) * _SEGMENTS
        triangles.append(np.stack([low + i, low + j, high + j], axis=1))
        triangles.append(np.stack([low + i, high + j, high + i], axis=1))
    last = (len(rings) - 1) * _SEGMENTS
    triangles.append(np.stack([np.full(_SEGMENTS, top), last + i, last + j], axis=1))
    return _without_slivers(
        Solid(np.concatenate([*points, tips]), np.concatenate(triangles).astype(np.int32))
    )


def round_cone(radius_low: float, radius_high: float, height: float) -> Solid:
    """Two half spheres at -height/2 and height/2 joined by a truncated cone."""
    polar = np.linspace(0, math.pi / 2, _SEGMENTS // 4 + 1)
    low = [(-height / 2 - radius_low * math.cos(a), radius_low * math.sin(a)) for a in polar]
    high = [(height / 2 + radius_high * math.sin(a), radius_high * math.cos(a)) for a in polar]
    return revolved([*low, *high])


def slab(solid: Solid, thickness: float) -> Solid:
    """A flat mesh, extended by a thickness to the side from which its faces are not seen."""
    a, b, c = (solid.points[solid.triangles[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a).sum(axis=0)
    length = np.linalg.norm(normal)
    if length == 0:
        return solid
    lower = solid.points - normal / length * thickness
    count = len(solid.points)
    return Solid(
        np.concatenate([solid.points, lower]),
        np.concatenate([solid.triangles, solid.triangles[:, ::-1] + count]).astype(np.int32),
    )


def _without_slivers(solid: Solid) -> Solid:
    """Merges coinciding points and drops the triangles that this leaves without area."""
    points, merged = np.unique(solid.points.round(12), axis=0, return_inverse=True)
    triangles = merged.ravel()[solid.triangles]
    a, b, c = triangles.T
    proper = (a != b) & (b != c) & (a != c)
    return Solid(points, triangles[proper].astype(np.int32))
