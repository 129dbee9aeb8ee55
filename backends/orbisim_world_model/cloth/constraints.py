"""What is known of a cloth and needs no learning: edges keep their lengths, nothing is inside.

Position-based dynamics (Mueller et al. 2007, Position Based Dynamics, sections 3.3 and 4.3):
vertices are moved by what their edges and contacts ask for, all at once, several times. Contacts
are planes: distance and normal where a step would have ended.
"""

from __future__ import annotations

import torch
from torch import Tensor

from orbisim_world_model.cloth.mesh import Mesh
from orbisim_world_model.cloth.solids import Near

_RELAXED = 1.2
"""Times the mean of what a vertex' edges ask for: the mean alone is the safe and slow choice
(Macklin et al. 2014, Unified Particle Physics, section 4.2, has 1 to 2)."""
_TINY = 1e-9
"""m: edges below it have no direction."""


def middles(mesh: Mesh, places: Tensor) -> Tensor:
    """[..., E, 3] of the edges of vertices [..., V, 3]."""
    ends: Tensor = places[..., mesh.edge, :]
    return ends.mean(-2)


def projected(
    mesh: Mesh, places: Tensor, began: Tensor, near: Near, sliding: Tensor, times: int
) -> Tensor:
    """Vertices [B, V, 3] moved to where edges keep their lengths and nothing is inside.

    Args:
      mesh: the cloth.
      places: where a step would end [B, V, 3]. began: where it began.
      near: of the vertices and then of the edges' middles at `places`, [B, V + E].
      sliding: [B] friction coefficients.
      times: how often.
    """
    count, start = mesh.vertices, places
    rest = torch.cat([mesh.rest, mesh.rest.new_zeros(1)])[mesh.along]
    real = (mesh.along < len(mesh.rest)).to(places.dtype)
    share = _RELAXED * 0.5 / real.sum(-1)
    depth = near.distance - mesh.radius
    reach = _along_edges(mesh, near.normal[:, count:], real)
    for _ in range(times):
        away = places[:, mesh.neighbour] - places[:, :, None]
        length = (away.square().sum(-1) + _TINY**2).sqrt()
        pull = real * (1 - rest / length.clamp_min(_TINY))
        places = places + share[:, None] * (pull[..., None] * away).sum(2)
        places = _outside(mesh, places, start, near.normal, depth, reach)
    return _held(places, began, near, depth[:, :count], sliding)


def _along_edges(mesh: Mesh, normal: Tensor, real: Tensor) -> tuple[Tensor, Tensor]:
    """Normals of the middles of each vertex' edges, and which edges there are [V, N]."""
    padded = torch.cat([normal, torch.zeros_like(normal[:, :1])], dim=1)
    return padded[:, mesh.along], real


def _outside(
    mesh: Mesh,
    places: Tensor,
    start: Tensor,
    normal: Tensor,
    depth: Tensor,
    reach: tuple[Tensor, Tensor],
) -> Tensor:
    """Vertices pushed out along the normals, and by the middles of their edges."""
    count = mesh.vertices
    moved = places - start
    own = depth[:, :count] + (moved * normal[:, :count]).sum(-1)
    places = places + (-own).clamp_min(0.0)[..., None] * normal[:, :count]
    middle = depth[:, count:] + (middles(mesh, places - start) * normal[:, count:]).sum(-1)
    push = torch.cat([(-middle).clamp_min(0.0), torch.zeros_like(middle[:, :1])], dim=1)
    each = push[:, mesh.along]
    total = each.sum(-1, keepdim=True).clamp_min(_TINY)
    weight = each / total  # the deepest middle decides, others by their share
    return places + ((weight * each)[..., None] * reach[0]).sum(2)


def _held(places: Tensor, began: Tensor, near: Near, depth: Tensor, sliding: Tensor) -> Tensor:
    """Friction: what was pushed out by a depth slides by that much less, times the coefficient."""
    normal = near.normal[:, : places.shape[1]]
    moved = places - began
    across = moved - (moved * normal).sum(-1, keepdim=True) * normal
    length = (across.square().sum(-1) + _TINY**2).sqrt()
    bound = sliding[:, None] * (-depth).clamp_min(0.0)
    kept = (1 - bound / length).clamp_min(0.0)
    return places - (1 - kept)[..., None] * across
