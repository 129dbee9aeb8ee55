"""`ShapeNetwork`: a cloth as one token whose shape feature is a part of the state.

The paper rolls out a point cloud's feature (appendix B.4: Point Transformer V3, no decoder back to
points is described). Here the feature can be turned back into vertices, so that a state stays a
state: the largest principal components of the vertices in the cloth's own frame, which is about
their mean and turned with them about the vertical. What stands on the floor is one token more:
distances at the points of a lattice in that frame.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from orbisim_world_model.cloth.mesh import Cloth, Mesh
from orbisim_world_model.cloth.solids import Solids, nearest

_REACH, _HEIGHTS = 0.5, (0.0, 0.08, 0.16, 0.24, 0.32, 0.4)
"""m: half side of the lattice, which is what a cloth of 0.77 m covers when it lies, and heights of
its layers, up to the highest objects of the task."""
_SIDE = 11
"""Points along it: 0.1 m apart, as wide as the thinnest seat is deep."""
_NEAR = 0.1  # m: over which a distance is told, the lattice's own spacing
_TINY = 1e-9
"""m: a cloth that narrow has no heading."""


class ShapeNetwork(nn.Module):
    """One step of the shape feature.

    Args:
      width, layers: of the token. codes: principal components. vertices: of the cloth.
    """

    basis: Tensor
    mean: Tensor
    spread: Tensor

    def __init__(self, width: int, layers: int, codes: int, vertices: int) -> None:
        super().__init__()
        self.codes = codes
        self.register_buffer("basis", torch.zeros(codes, vertices * 3))
        self.register_buffer("mean", torch.zeros(vertices * 3))
        self.register_buffer("spread", torch.ones(4, codes + 3))
        self.enter = nn.Linear(2 * codes + 4, width)
        points = _SIDE**2 * len(_HEIGHTS)
        self.scene = nn.Sequential(nn.Linear(points, width), nn.SiLU(), nn.Linear(width, width))
        self.blocks = nn.ModuleList(
            nn.Sequential(
                nn.LayerNorm(2 * width),
                nn.Linear(2 * width, 2 * width),
                nn.SiLU(),
                nn.Linear(2 * width, width),
            )
            for _ in range(layers)
        )
        self.leave = nn.Linear(width, 2 * (codes + 3))
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def fit(self, mesh: Mesh, before: Cloth, after: Cloth, fallen: Cloth) -> None:
        """Takes the components of shapes [B, V, 3], and units, from steps of the data."""
        frame = headings(mesh, before.pos)
        local = _local(frame, before.pos, before.pos.mean(1, keepdim=True))
        self.mean.copy_(local.mean(0))
        parts = torch.linalg.svd(local - self.mean, full_matrices=False)[2]
        have = min(self.codes, len(parts))
        self.basis[:have].copy_(parts[:have])
        codes = self._codes(frame, before)
        rest = self._change(frame, after, fallen)
        rows = [*codes, *rest]
        self.spread.copy_(torch.stack([row.square().mean(0).sqrt() for row in rows]) + 1e-6)

    def _codes(self, frame: Tensor, x: Cloth) -> tuple[Tensor, Tensor]:
        """Features of positions and velocities [B, codes + 3]; the last 3 are of the mean."""
        centre, drift = x.pos.mean(1, keepdim=True), x.vel.mean(1, keepdim=True)
        shape = (_local(frame, x.pos, centre) - self.mean) @ self.basis.T
        moving = _local(frame, x.vel, drift) @ self.basis.T
        up = torch.zeros_like(centre)
        up[..., 2] = centre[..., 2]
        return (
            torch.cat([shape, up[:, 0]], dim=-1),
            torch.cat([moving, (drift @ frame)[:, 0]], dim=-1),
        )

    def _change(self, frame: Tensor, after: Cloth, fallen: Cloth) -> tuple[Tensor, Tensor]:
        """What positions and velocities change beyond free fall, as features."""
        pairs = []
        for there, free in zip(after, fallen, strict=True):
            gap = there - free
            middle = gap.mean(1, keepdim=True)
            code = _local(frame, gap, middle) @ self.basis.T
            pairs.append(torch.cat([code, (middle @ frame)[:, 0]], dim=-1))
        return pairs[0], pairs[1]

    def spanned(self, mesh: Mesh, x: Cloth) -> Cloth:
        """The cloth [B, V, 3] that the components tell of a cloth."""
        frame = headings(mesh, x.pos)
        shape, moving = self._codes(frame, x)
        return Cloth(
            self._points(frame, shape[:, :-3], True) + x.pos.mean(1, keepdim=True),
            self._points(frame, moving[:, :-3], False) + x.vel.mean(1, keepdim=True),
        )

    def forward(self, x: Cloth, fallen: Cloth, solids: Solids, mesh: Mesh, scale: Tensor) -> Cloth:
        """The cloth [B, V, 3] after a step, within what the components span."""
        frame, centre = headings(mesh, x.pos), x.pos.mean(1, keepdim=True)
        shape, moving = self._codes(frame, x)
        seen = torch.cat([shape[:, :-3], moving, shape[:, -1:]], dim=-1)
        unit = torch.cat([self.spread[0, :-3], self.spread[1], self.spread[0, -1:]])
        h = self.enter(seen / unit)
        still = self.scene(self._lattice(frame, centre, solids))
        for block in self.blocks:
            h = h + block(torch.cat([h, still], dim=-1))
        change = self.leave(h).unflatten(-1, (2, -1)) * self.spread[2:]
        free, going = self._codes(frame, Cloth(fallen.pos, fallen.vel))
        return Cloth(
            self._points(frame, free[:, :-3] + change[:, 0, :-3], True)
            + fallen.pos.mean(1, keepdim=True)
            + change[:, :1, -3:] @ frame.transpose(1, 2),
            self._points(frame, going[:, :-3] + change[:, 1, :-3], False)
            + fallen.vel.mean(1, keepdim=True)
            + change[:, 1:, -3:] @ frame.transpose(1, 2),
        )

    def _points(self, frame: Tensor, code: Tensor, placed: bool) -> Tensor:
        """Vertices [B, V, 3] of a feature, about their mean."""
        local = code @ self.basis + (self.mean if placed else 0.0)
        return local.unflatten(-1, (-1, 3)) @ frame.transpose(1, 2)

    def _lattice(self, frame: Tensor, centre: Tensor, solids: Solids) -> Tensor:
        """Distances at the lattice's points, told over `_NEAR`."""
        axis = torch.linspace(-_REACH, _REACH, _SIDE)
        grid = torch.cartesian_prod(axis, axis, torch.tensor(_HEIGHTS)).to(frame)
        flat = centre * centre.new_tensor([1.0, 1.0, 0.0])
        points = grid @ frame.transpose(1, 2) + flat
        return (nearest(solids, points).distance / _NEAR).clamp(-1.0, 1.0)


def headings(mesh: Mesh, places: Tensor) -> Tensor:
    """[B, 3, 3]: turns about the vertical by which vertices [B, V, 3] fit the cloth at rest best,
    seen from above (the plane's orthogonal Procrustes problem)."""
    away = places - places.mean(1, keepdim=True)
    flat = mesh.flat
    along = (flat[:, 0] * away[..., 0] + flat[:, 1] * away[..., 1]).sum(-1)
    across = (flat[:, 0] * away[..., 1] - flat[:, 1] * away[..., 0]).sum(-1)
    size = (along.square() + across.square() + _TINY**2).sqrt()
    c, s, zero, one = along / size, across / size, torch.zeros_like(size), torch.ones_like(size)
    return torch.stack([c, -s, zero, s, c, zero, zero, zero, one], dim=-1).unflatten(-1, (3, 3))


def _local(frame: Tensor, values: Tensor, middle: Tensor) -> Tensor:
    """Vectors [B, V, 3] about a middle, in a frame, as rows [B, 3 V]."""
    return ((values - middle) @ frame).flatten(1)
