"""Forward kinematics of the hand in torch: from joint coordinates to its pose and velocity."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from orbisim_world_model.layout import Layout
from orbisim_world_model.rotation import product


class Kinematics(nn.Module):
    """Pose and velocity of the hand, as a product of the transforms of the joints before it.

    Each joint has a frame at its anchor whose z axis is the joint's axis.

    Args:
      layout: of a scene with a hand (`layout.chain` is not empty).
    """

    def __init__(self, layout: Layout) -> None:
        super().__init__()
        constants = {
            "basis": torch.tensor(layout.chain, dtype=torch.float32).reshape(-1, 4, 4, 4),
            "tip": torch.tensor(layout.tip, dtype=torch.float32).reshape(4, 4),
            "turns": torch.tensor([float(layout.hinge[j]) for j in layout.chain_joints]),
            "joints": torch.tensor(layout.chain_joints, dtype=torch.long),
        }
        for name, value in constants.items():
            self.register_buffer(name, value, persistent=False)

    def forward(self, q: Tensor, v: Tensor) -> Tensor:
        """The hand [B, 18] of joint positions and velocities [B, J] (see `Entities.hand`)."""
        q, v = q.index_select(1, self.joints), v.index_select(1, self.joints)  # [B, C]
        terms = torch.stack([torch.ones_like(q), q.sin(), q.cos(), q], dim=-1)  # [B, C, 4]
        local = (terms[..., None, None] * self.basis).sum(2)  # [B, C, 4, 4]
        stacked = _running_products(local)  # [B, C, 4, 4]
        hand = product(stacked[:, -1], self.tip)
        axis, anchor = stacked[..., :3, 2], stacked[..., :3, 3]  # [B, C, 3]
        turning = axis * (v * self.turns)[..., None]
        sliding = axis * (v * (1.0 - self.turns))[..., None]
        arm = hand[:, None, :3, 3] - anchor
        linear = (torch.linalg.cross(turning, arm) + sliding).sum(1)
        return torch.cat(
            [hand[:, :3, 3], hand[:, :3, :3].flatten(1), linear, turning.sum(1)], dim=1
        )


def _running_products(matrices: Tensor) -> Tensor:
    """Product of each matrix with all before it, [B, C, n, n], in log2(C) steps."""
    reach = 1
    while reach < matrices.shape[1]:
        longer = product(matrices[:, :-reach], matrices[:, reach:])
        matrices = torch.cat([matrices[:, :reach], longer], dim=1)
        reach *= 2
    return matrices
