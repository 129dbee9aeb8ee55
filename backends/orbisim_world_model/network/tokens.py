"""What networks with one token for each entity share."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from orbisim_world_model.network.inputs import Inputs


class TokenNetwork(nn.Module):
    """The memory at the start, and the condition of each token.

    Attributes:
      robot_token: 1 if there is a robot, else 0. count: number of objects.
      start: [2, width], memory of the robot's and of an object's token.
      robot_condition, object_condition: from what conditions a token to [..., width].
    """

    robot_token: int
    count: int
    start: nn.Parameter
    robot_condition: nn.Module
    object_condition: nn.Module

    def initial_memory(self, batch: int) -> Tensor:
        """[B, K, width]: learned, one for robots and one for objects."""
        robot = self.start[:1].expand(self.robot_token, -1)
        tokens = torch.cat([robot, self.start[1:].expand(self.count, -1)])
        return tokens.expand(batch, -1, -1)

    def condition(self, inputs: Inputs) -> Tensor:
        """c [B, K, width] of AdaLN."""
        world, parts = inputs.world, []
        if self.robot_token:
            parts.append(self.robot_condition(torch.cat([inputs.control, world], -1))[:, None])
        if self.count:
            spread = world[:, None].expand(-1, inputs.attributes.shape[1], -1)
            parts.append(self.object_condition(torch.cat([inputs.attributes, spread], -1)))
        return parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)
