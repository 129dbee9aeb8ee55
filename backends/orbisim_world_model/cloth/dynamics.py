"""`ClothDynamics`: one learned step of a cloth."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from orbisim_world_model.cloth.config import ClothModel
from orbisim_world_model.cloth.constraints import middles, projected
from orbisim_world_model.cloth.features import features
from orbisim_world_model.cloth.graph import GraphNetwork
from orbisim_world_model.cloth.mesh import Cloth, Mesh
from orbisim_world_model.cloth.shape import ShapeNetwork
from orbisim_world_model.cloth.solids import Near, Solids, nearest


class ClothDynamics(nn.Module):
    """Free fall, what the network adds, and what is known of edges and contacts.

    Args:
      config: of the model.
      mesh: of the scene; another may be given to each call of a `graph`.
    """

    scale: Tensor

    def __init__(self, config: ClothModel, mesh: Mesh) -> None:
        super().__init__()
        self.config, self.mesh = config, mesh
        self.network: GraphNetwork | ShapeNetwork | None = None
        if config.kind == "graph":
            self.network = GraphNetwork(config.width, config.layers)
        elif config.kind == "shape":
            sizes = (config.codes, mesh.vertices)
            self.network = ShapeNetwork(config.width, config.layers, *sizes)
        self.register_buffer("scale", torch.ones(2))

    def normalise(self, changes: Tensor) -> None:
        """Takes units from changes of position and velocity beyond free fall [..., 2], their root
        mean squares, m and m/s."""
        self.scale.copy_(changes)

    def forward(self, x: Cloth, solids: Solids, turn: Tensor | None = None) -> Cloth:
        """The cloth after a step.

        Args:
          x: [B, V, 3]. solids: of B scenes.
          turn: [B, 3, 3] in which frame the network sees directions; the world's if None.
        """
        kind, mesh = self.config.kind, self.mesh
        if kind == "copy":
            return x
        if kind == "constant_velocity":
            return Cloth(x.pos + mesh.timestep * x.vel, x.vel)
        fallen = free_fall(mesh, x)
        if isinstance(self.network, ShapeNetwork):
            return self.network(x, fallen, solids, mesh, self.scale)
        if self.network is not None:
            seen = features(mesh, x, self._near(solids, x.pos), turn)
            out = self.network(seen, mesh) * seen.company  # alone in the air, it only falls
            out = out.unflatten(-1, (2, 3)) * self.scale[:, None]
            if turn is not None:
                out = (out.flatten(1, 2) @ turn.transpose(1, 2)).reshape(out.shape)
            fallen = Cloth(fallen.pos + out[..., 0, :], fallen.vel + out[..., 1, :])
        if not self.config.projections:
            return fallen
        near = self._near(solids, fallen.pos)
        places = projected(mesh, fallen.pos, x.pos, near, solids.sliding, self.config.projections)
        return Cloth(places, fallen.vel + (places - fallen.pos) / mesh.timestep)

    def told(self, x: Cloth) -> Cloth:
        """As much of a cloth [B, V, 3] as the model can tell; all of it but of a shape feature."""
        if isinstance(self.network, ShapeNetwork):
            return self.network.spanned(self.mesh, x)
        return x

    def _near(self, solids: Solids, places: Tensor) -> Near:
        """What is near vertices and the middles of edges [B, V + E]."""
        return nearest(solids, torch.cat([places, middles(self.mesh, places)], dim=1))


def free_fall(mesh: Mesh, x: Cloth) -> Cloth:
    """A step under gravity alone."""
    dt = mesh.timestep
    return Cloth(x.pos + dt * x.vel + 0.5 * dt**2 * mesh.gravity, x.vel + dt * mesh.gravity)


def rolled(
    model: ClothDynamics, x: Cloth, solids: Solids, steps: int, turn: Tensor | None = None
) -> Cloth:
    """The states [T, B, V, 3] after each of so many steps."""
    found = []
    for _ in range(steps):
        x = model(x, solids, turn)
        found.append(x)
    return Cloth(*(torch.stack(field) for field in zip(*found, strict=True)))
