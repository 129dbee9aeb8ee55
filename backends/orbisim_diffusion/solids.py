"""Values that the renderer is conditioned on, as torch tensors: geoms and cameras.

Shapes: B views, G geoms.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import torch
from torch import Tensor

ABSENT = -2
"""In the field `entity`: padding, where another view has more geoms."""


class Solids(NamedTuple):
    """The geoms that are seen.

    Attributes:
      kind: [B, G] MuJoCo's number of the type. size: [B, G, 3] its sizes, m.
      colour: [B, G, 3], 0 to 1. entity: [B, G] as in `orbisim.scene.visible`.
      pos: [B, G, 3], m. rot: [B, G, 3, 3], both in the world frame.
    """

    kind: Tensor
    size: Tensor
    colour: Tensor
    entity: Tensor
    pos: Tensor
    rot: Tensor

    def at(self, index: Tensor | slice) -> Solids:
        """The same fields at an index of the leading axis."""
        return Solids(*(field[index] for field in self))


class Lamps(NamedTuple):
    """Lights (see `orbisim.scene.visible.LIGHT_COLUMNS`); L of them.

    Attributes:
      rows: [B, L, 9].
    """

    rows: Tensor

    @property
    def pos(self) -> Tensor:
        """[B, L, 3], m."""
        return self.rows[..., :3]

    @property
    def direction(self) -> Tensor:
        """[B, L, 3]."""
        return self.rows[..., 3:6]

    @property
    def directional(self) -> Tensor:
        """[B, L], 1 where the light comes from infinitely far."""
        return self.rows[..., 6]

    @property
    def shadow(self) -> Tensor:
        """[B, L], 1 where it throws shadows; padding has 0 and no direction."""
        return self.rows[..., 8]


class View(NamedTuple):
    """Cameras (see `orbisim.cameras.Camera`).

    Attributes:
      pos: [B, 3], m. rot: [B, 3, 3]. focal, offset: [B, 2] in image heights.
    """

    pos: Tensor
    rot: Tensor
    focal: Tensor
    offset: Tensor

    def at(self, index: Tensor | slice) -> View:
        """The same fields at an index of the leading axis."""
        return View(*(field[index] for field in self))


def constant(values: tuple[float, ...], like: Tensor) -> Tensor:
    """Numbers as a tensor of the type and on the device of another one, copied there once.

    A copy from the host waits for all that the device was told to do. Such tensors are kept for
    good, some hundred bytes each: recorded work (`playback`) reads them where they lie.
    """
    return _constant(values, like.dtype, like.device)


@functools.cache
def _constant(values: tuple[float, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    return torch.tensor(values, dtype=dtype, device=device)


def rays(view: View, height: int, width: int) -> Tensor:
    """Directions [B, height * width, 3] in the world frame; their component forward is 1."""
    device, dtype = view.pos.device, view.pos.dtype
    x = (torch.arange(width, device=device, dtype=dtype) + 0.5 - width / 2) / height
    y = (torch.arange(height, device=device, dtype=dtype) + 0.5 - height / 2) / height
    y, x = torch.meshgrid(y, x, indexing="ij")
    right = (x.reshape(1, -1) - view.offset[:, :1]) / view.focal[:, :1]
    down = (y.reshape(1, -1) - view.offset[:, 1:]) / view.focal[:, 1:]
    local = torch.stack([right, -down, -torch.ones_like(right)], dim=-1)  # [B, P, 3]
    return local @ view.rot.transpose(-1, -2)


def project(view: View, points: Tensor) -> tuple[Tensor, Tensor]:
    """Where points [B, N, 3] are on the image.

    Returns:
      [B, N, 2] right and down from the middle in image heights, and the depth [B, N], m.
    """
    local = (points - view.pos[:, None]) @ view.rot
    depth = -local[..., 2]
    safe = depth.clamp_min(1e-3)
    plane = torch.stack([local[..., 0] / safe, -local[..., 1] / safe], dim=-1)
    return plane * view.focal[:, None] + view.offset[:, None], depth


def matrices(quat: Tensor) -> Tensor:
    """Rotation matrices [..., 3, 3] of quaternions [..., 4] (w, x, y, z), normalised first."""
    w, x, y, z = (quat / quat.norm(dim=-1, keepdim=True).clamp_min(1e-9)).unbind(-1)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))
