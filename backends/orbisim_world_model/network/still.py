"""The baseline that predicts no change of velocity."""

from __future__ import annotations

from torch import Tensor, nn

from orbisim_world_model.config import ModelConfig
from orbisim_world_model.network.inputs import Inputs, Outputs, Sizes
from orbisim_world_model.parts import FREE, OUTPUTS


class StillNetwork(nn.Module):
    """Constant velocity: every change that a network could predict is zero."""

    def __init__(self, sizes: Sizes, config: ModelConfig) -> None:
        super().__init__()
        self.sizes = sizes

    def initial_memory(self, batch: int) -> Tensor:
        """[B, 0]."""
        import torch

        return torch.zeros(batch, 0)

    def encode(self, inputs: Inputs, memory: Tensor) -> Tensor:
        """Nothing."""
        return memory

    def forward(self, inputs: Inputs, memory: Tensor, observe: bool = True) -> Outputs:
        """Zeros."""
        batch, sizes = len(inputs.world), self.sizes
        robot = inputs.world.new_zeros((batch, sizes.robot_out))
        objects = inputs.world.new_zeros((batch, sizes.many, sizes.objects_out))
        parts = None
        if sizes.parts:
            parts = robot.new_zeros((batch, sizes.parts, sizes.part_outputs))
            if sizes.part_outputs == OUTPUTS:
                parts[..., -1] = FREE
        return Outputs(robot, objects, memory, memory, robot.new_zeros(()), parts=parts)
