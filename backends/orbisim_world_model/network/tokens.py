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
      describes: whether it has `scales` of AdaLN that descriptors alone decide, to be made once for
        many steps.
    """

    robot_token: int
    count: int
    parts: int
    start: nn.Parameter
    robot_condition: nn.Module
    object_condition: nn.Module
    part_condition: nn.Module | None
    describes: bool = False

    def initial_memory(self, batch: int) -> Tensor:
        """[B, K, width]: learned, one for robots, one for objects and one for parts."""
        robot = self.start[:1].expand(self.robot_token, -1)
        tokens = torch.cat([robot, self.start[1:2].expand(self.count, -1)])
        if self.parts:
            tokens = torch.cat([tokens, self.start[2:].expand(self.parts, -1)])
        return tokens.expand(batch, -1, -1)

    def condition(self, inputs: Inputs) -> Tensor:
        """c [B, K, width] of AdaLN."""
        parts = self.described(inputs.attributes, inputs.world, inputs.part_attributes)
        if self.robot_token:
            moved = torch.cat([inputs.control, inputs.world], dim=-1)
            parts.insert(0, self.robot_condition(moved)[:, None])
        return parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)

    def described(
        self, attributes: Tensor, world: Tensor, part_attributes: Tensor | None
    ) -> list[Tensor]:
        """c of objects and of parts, which descriptors alone decide."""
        kinds = (
            (self.object_condition, attributes if self.count else None),
            (self.part_condition, part_attributes),
        )
        return [
            condition(torch.cat([seen, world[:, None].expand(-1, seen.shape[1], -1)], dim=-1))
            for condition, seen in kinds
            if condition is not None and seen is not None
        ]
