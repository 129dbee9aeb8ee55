"""`GraphNetwork`: messages among the vertices of a cloth along its edges.

After MeshGraphNets (Pfaff et al. 2021, Learning Mesh-Based Simulation with Graph Networks), with
the sum of two vertices' and their edge's linear functions as a message, and the mean over the
cloth as a token that every vertex sees.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from orbisim_world_model.cloth.features import EDGE, NODE, Seen
from orbisim_world_model.cloth.mesh import Mesh

OUT = 6
"""Numbers for each vertex: changes of position and velocity beyond free fall."""


class Messages(nn.Module):
    """One round.

    Args:
      width: of a vertex.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.own, self.other = nn.Linear(width, width), nn.Linear(width, width, bias=False)
        self.edge = nn.Linear(EDGE, width, bias=False)
        self.whole = nn.Linear(width, width, bias=False)
        self.first, self.last = nn.Linear(2 * width, width), nn.Linear(width, width)
        self.norm = nn.LayerNorm(width)

    def forward(self, h: Tensor, seen: Seen, mesh: Mesh) -> Tensor:
        """Vertices [B, V, width] after the round."""
        normed = self.norm(h)
        other = self.other(normed)[:, mesh.neighbour]
        message = nn.functional.silu(self.own(normed)[:, :, None] + other + self.edge(seen.edge))
        heard = (message * seen.real).sum(2)
        whole = self.whole(normed.mean(1, keepdim=True))
        inner = nn.functional.silu(self.first(torch.cat([normed, heard], dim=-1)) + whole)
        return h + self.last(inner)


class GraphNetwork(nn.Module):
    """From what is seen of a cloth to numbers [B, V, OUT]; zero before training.

    Args:
      width: of a vertex. layers: rounds of messages.
    """

    def __init__(self, width: int, layers: int) -> None:
        super().__init__()
        self.enter = nn.Sequential(nn.Linear(NODE, width), nn.SiLU(), nn.Linear(width, width))
        self.rounds = nn.ModuleList(Messages(width) for _ in range(layers))
        self.norm, self.leave = nn.LayerNorm(width), nn.Linear(width, OUT)
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)

    def forward(self, seen: Seen, mesh: Mesh) -> Tensor:
        """Numbers [B, V, OUT] in units of a typical step."""
        h = self.enter(seen.node)
        for one in self.rounds:
            h = one(h, seen, mesh)
        out: Tensor = self.leave(self.norm(h))
        return out
