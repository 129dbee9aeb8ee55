"""Forward kinematics of a robot's capsules in torch: where their ends are and how they move."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from orbisim_world_model.layout import Layout
from orbisim_world_model.rotation import product


class Capsules(NamedTuple):
    """Capsules [C] of a batch of states, in the world frame.

    Attributes:
      ends, speeds: [B, C, 2, 3] of the two ends of the axis, m and m/s.
      turning: [B, C, 3] angular velocity, rad/s.
    """

    ends: Tensor
    speeds: Tensor
    turning: Tensor


class LimbKinematics(nn.Module):
    """`Capsules` of joint positions and velocities.

    Joints that the dynamics do not depend on (`layout.ignored`) are taken to be at 0.

    Args:
      layout: with limbs.
    """

    def __init__(self, layout: Layout) -> None:
        super().__init__()
        limbs = layout.limbs
        self.levels = _levels(limbs.parents)
        order = [j for level in self.levels for j in level]
        place = {joint: i for i, joint in enumerate(order)}
        self._keep("seen", [float(not ignored) for ignored in layout.ignored])
        self._keep("turns", [float(hinge) for hinge in layout.hinge])
        self._keep("basis", limbs.bases)
        self._keep("ends", limbs.ends)
        self._keep("moved_by", limbs.joints, torch.long)
        self._keep("sorted", [place[j] for j in range(len(order))], torch.long)
        for number, level in enumerate(self.levels):
            self._keep(f"joints{number}", level, torch.long)
            self._keep(
                f"parents{number}", [place.get(limbs.parents[j], 0) for j in level], torch.long
            )
        self._keep("ancestors", _ancestors(limbs.parents, limbs.joints))

    def forward(self, q: Tensor, v: Tensor) -> Capsules:
        """Of positions and velocities [B, J]."""
        frames = self.frames(q)  # [B, J, 4, 4]
        axis, anchor = frames[..., :3, 2], frames[..., :3, 3]
        turning = axis * (v * self.turns)[..., None]  # [B, J, 3]
        moving = axis * (v * (1.0 - self.turns))[..., None]
        moving = moving - torch.linalg.cross(turning, anchor)
        reach = self.ancestors[..., None]  # [C, J, 1]
        turning = (turning[:, None] * reach).sum(2)  # [B, C, 3]
        moving = (moving[:, None] * reach).sum(2)
        place = frames.index_select(1, self.moved_by)[:, :, None]  # [B, C, 1, 4, 4]
        ends = (place[..., :3, :3] * self.ends[:, :, None]).sum(-1) + place[..., :3, 3]
        around = turning[:, :, None].expand(ends.shape)
        speeds = moving[:, :, None] + torch.linalg.cross(around, ends)
        return Capsules(ends, speeds, turning)

    def frames(self, q: Tensor) -> Tensor:
        """Joints' frames in the world [B, J, 4, 4]."""
        q = q * self.seen
        terms = torch.stack([torch.ones_like(q), q.sin(), q.cos(), q], dim=-1)  # [B, J, 4]
        local = (terms[..., None, None] * self.basis).sum(2)
        found = local.index_select(1, self.joints0)
        for number in range(1, len(self.levels)):
            here = local.index_select(1, getattr(self, f"joints{number}"))
            before = found.index_select(1, getattr(self, f"parents{number}"))
            found = torch.cat([found, product(before, here)], dim=1)
        return found.index_select(1, self.sorted)

    def _keep(self, name: str, values: object, kind: torch.dtype = torch.float32) -> None:
        self.register_buffer(name, torch.tensor(values, dtype=kind), persistent=False)


def _levels(parents: tuple[int, ...]) -> list[list[int]]:
    """Joints by their depth in the tree."""
    depth: list[int] = []
    for parent in parents:
        depth.append(0 if parent < 0 else depth[parent] + 1)
    return [[j for j, d in enumerate(depth) if d == level] for level in range(max(depth) + 1)]


def _ancestors(parents: tuple[int, ...], joints: tuple[int, ...]) -> list[list[float]]:
    """[C, J]: 1 where a joint moves a capsule."""
    rows = []
    for joint in joints:
        row = [0.0] * len(parents)
        while joint >= 0:
            row[joint] = 1.0
            joint = parents[joint]
        rows.append(row)
    return rows
