"""What a robot's limbs can touch, as the network sees it: the floor, each other, their limits."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from orbisim_world_model.layout import Layout
from orbisim_world_model.limbs import Capsules, LimbKinematics
from orbisim_world_model.normalization import fine

_HEIGHT, _SPEED, _ANGLE, _NEAR = 0.005, 0.05, 0.02, 0.03
"""Scales below which distances (m), speeds (m/s) and joint limits (rad) are seen finely; distance
over which what two limbs do to each other fades out (m)."""
_TINY = 1e-9
"""Keeps distances differentiable at zero; its root is 0.03 mm."""


class Touch(nn.Module):
    """Features of limbs, beside those of the joints.

    Args:
      layout: with limbs.
    """

    def __init__(self, layout: Layout) -> None:
        super().__init__()
        limbs = layout.limbs
        self.kinematics = LimbKinematics(layout)
        limited = [j for j, (low, high) in enumerate(limbs.limits) if high > low]
        self.pairs, self.grounded = bool(limbs.pairs), bool(limbs.grounded)
        self.height = limbs.height
        longs = {
            "limited": limited,
            "low": limbs.grounded,
            "one": [i for i, _ in limbs.pairs],
            "other": [j for _, j in limbs.pairs],
        }
        for name, values in longs.items():
            self.register_buffer(name, torch.tensor(values, dtype=torch.long), persistent=False)
        bounds = torch.tensor([limbs.limits[j] for j in limited]).reshape(-1, 2)
        self.register_buffer("bounds", bounds, persistent=False)
        self.register_buffer("radii", torch.tensor(limbs.radii), persistent=False)

    def forward(self, q: Tensor, v: Tensor) -> Tensor:
        """[B, F] of joint positions and velocities [B, J]."""
        capsules = self.kinematics(q, v)
        offset = capsules.ends - capsules.ends[:, :1, :1]
        parts = [offset, capsules.speeds, fine(capsules.speeds, _SPEED)]
        parts = [part.flatten(1) for part in parts]
        if len(self.limited):
            q = q.index_select(1, self.limited)
            parts += [fine(q - self.bounds[:, 0], _ANGLE), fine(self.bounds[:, 1] - q, _ANGLE)]
        if self.grounded:
            parts.append(self.floor(capsules))
        if self.pairs:
            parts.append(self.each_other(capsules))
        return torch.cat(parts, dim=1)

    def floor(self, capsules: Capsules) -> Tensor:
        """[B, F]: height over the floor and velocity of the lowest point at each end."""
        ends, speeds = (part.index_select(1, self.low) for part in capsules[:2])
        turning = capsules.turning.index_select(1, self.low)[:, :, None]
        radius = self.radii.index_select(0, self.low)[:, None]
        height = ends[..., 2] - radius - self.height  # [B, C, 2]
        x = speeds[..., 0] - turning[..., 1] * radius  # w x (0, 0, -r)
        y = speeds[..., 1] + turning[..., 0] * radius
        near = torch.exp(-height.clamp(min=0.0) / _NEAR)
        sliding = [near * fine(x, _SPEED), near * fine(y, _SPEED)]
        parts = [height, fine(height, _HEIGHT), near * fine(speeds[..., 2], _SPEED), *sliding]
        return torch.stack(parts, dim=-1).flatten(1)

    def each_other(self, capsules: Capsules) -> Tensor:
        """[B, F]: distance of each pair, and when near its direction and relative velocity."""
        a, b = (Capsules(*(f.index_select(1, i) for f in capsules)) for i in (self.one, self.other))
        share_a, share_b = closest(a.ends, b.ends)
        apart = along(b.ends, share_b) - along(a.ends, share_a)  # [B, P, 3]
        length = apart.square().sum(-1, keepdim=True).add(_TINY).sqrt()
        normal = apart / length
        radii = (self.radii.index_select(0, i)[:, None] for i in (self.one, self.other))
        radius_a, radius_b = radii
        distance = length - radius_a - radius_b
        speed = along(b.speeds, share_b) - along(a.speeds, share_a)
        speed = speed - torch.linalg.cross(b.turning * radius_b + a.turning * radius_a, normal)
        inward = (speed * normal).sum(-1, keepdim=True)
        sliding = speed - inward * normal
        near = torch.exp(-distance.clamp(min=0.0) / _NEAR)
        local = [normal, fine(inward, _SPEED), fine(sliding, _SPEED)]
        parts = [fine(distance, _HEIGHT), *(near * part for part in local)]
        return torch.cat(parts, dim=-1).flatten(1)


def closest(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Where segments a and b [B, P, 2, 3] are closest, as shares [B, P, 1] of the way along."""
    u, w = a[..., 1, :] - a[..., 0, :], b[..., 1, :] - b[..., 0, :]
    r = a[..., 0, :] - b[..., 0, :]

    def dot(x: Tensor, y: Tensor) -> Tensor:
        return (x * y).sum(-1, keepdim=True)

    uu, ww, uw, ur, wr = dot(u, u) + _TINY, dot(w, w) + _TINY, dot(u, w), dot(u, r), dot(w, r)
    s = ((uw * wr - ur * ww) / (uu * ww - uw * uw).clamp(min=_TINY)).clamp(0.0, 1.0)
    t = ((uw * s + wr) / ww).clamp(0.0, 1.0)
    return ((t * uw - ur) / uu).clamp(0.0, 1.0), t


def along(ends: Tensor, share: Tensor) -> Tensor:
    """Values [B, P, 3] between those at the two ends [B, P, 2, 3]."""
    return ends[..., 0, :] + share * (ends[..., 1, :] - ends[..., 0, :])
