"""`ClothEngine`: a checkpoint of learned cloth on a device, stepping states of one scene."""

from __future__ import annotations

import torch
from torch import Tensor

from orbisim.scene import Scene
from orbisim.state import Array, State
from orbisim_world_model.arrays import has_gradient, tensor
from orbisim_world_model.cloth.checkpoint import ClothCheckpoint
from orbisim_world_model.cloth.guard import ClothGuard
from orbisim_world_model.cloth.manifest import cloth_ranges
from orbisim_world_model.cloth.mesh import Cloth
from orbisim_world_model.cloth.solids import read_solids
from orbisim_world_model.stepping import Stepping, Steps


class ClothEngine(Stepping):
    """Steps cloths with a checkpoint.

    Args:
      checkpoint: for the scene's cloth. device: where to compute.
    """

    def __init__(self, checkpoint: ClothCheckpoint, device: torch.device) -> None:
        super().__init__(checkpoint, checkpoint.layout.to(device), device)
        self.model = checkpoint.model.to(device).requires_grad_(False)
        self.model.mesh = self.layout
        ranges = cloth_ranges(checkpoint.manifest, str(checkpoint.path))
        self.guard = ClothGuard(ranges, self.layout)

    def describe(self, scene: Scene) -> None:
        """Takes what stands still in the scene."""
        self._solids = read_solids(scene.model, scene.source).to(self.device)

    def memory(self, state: State) -> Tensor:
        """[B, 0]: positions and velocities of its vertices are all there is to know of a cloth."""
        return torch.zeros(state.nworld, 0, device=self.device)

    def run(self, state: State, controls: Array, nstep: int) -> Steps:
        """The states after every step, so many for each of the controls [B, T, 0]."""
        gradients = torch.is_grad_enabled() and any(map(has_gradient, (state.qpos, state.qvel)))
        with torch.set_grad_enabled(gradients):
            x: Cloth = self.entities(state)
            solids, found = self._solids.expand(state.nworld), []
            for _ in range(controls.shape[1] * nstep):
                x = self.model(x, solids)
                found.append(x)
            stacked = Cloth(*(torch.stack(field) for field in zip(*found, strict=True)))
        return Steps(stacked, self.memory(state))

    def entities(self, state: State) -> Cloth:
        """The state as the model sees it."""
        fields = (tensor(a, self.device) for a in (state.qpos, state.qvel))
        x: Cloth = self.layout.split(*fields)
        return x
