"""What networks with one token for each entity share."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from orbisim_world_model.network.inputs import Inputs


class TokenNetwork(nn.Module):
    """The memory at the start, and the condition of each token.

    Attributes:
      robot_token: 1 if there is a robot, else 0. count: number of objects. parts: of parts.
      start: [2 or 3, width], memory of the robot's, of an object's and of a part's token.
      robot_condition, object_condition, part_condition: from what conditions a token to
        [..., width].
    """

    robot_token: int
    count: int
    parts: int
    start: nn.Parameter
    robot_condition: nn.Module
    object_condition: nn.Module
    part_condition: nn.Module | None

    def initial_memory(self, batch: int) -> Tensor:
        """[B, K, width]: learned, one for robots, one for objects and one for parts."""
        robot = self.start[:1].expand(self.robot_token, -1)
        tokens = torch.cat([robot, self.start[1:2].expand(self.count, -1)])
        if self.parts:
            tokens = torch.cat([tokens, self.start[2:].expand(self.parts, -1)])
        return tokens.expand(batch, -1, -1)

    def condition(self, inputs: Inputs) -> Tensor:
        """c [B, K, width] of AdaLN."""
        world, parts = inputs.world, []
        if self.robot_token:
            parts.append(self.robot_condition(torch.cat([inputs.control, world], -1))[:, None])
        if self.count:
            spread = world[:, None].expand(-1, inputs.attributes.shape[1], -1)
            parts.append(self.object_condition(torch.cat([inputs.attributes, spread], -1)))
        if self.part_condition is not None and inputs.part_attributes is not None:
            spread = world[:, None].expand(-1, inputs.part_attributes.shape[1], -1)
            parts.append(self.part_condition(torch.cat([inputs.part_attributes, spread], -1)))
        return parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)
