"""`ClothGuard`: notices, at every step, cloths that diverge or leave the training data."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from orbisim_world_model.cloth.manifest import ClothRanges
from orbisim_world_model.cloth.mesh import Cloth, Mesh
from orbisim_world_model.guard import Notice, first_marked

_FAR = 1e4
"""m: no scene of a learned model is that large."""
_FAST, _TORN = 10.0, 2.0
"""Times the largest speed in training, and strain of an edge beyond the largest in training, that
no cloth reaches: edges do not become three times as long."""
_BEYOND, _SLACK = 2.0, 0.05
"""Times the largest speed and strain in training, and m of height, beyond which a state lies
outside the training data: a density thins out, it has no edge."""


class ClothGuard:
    """Bounds from the ranges in a checkpoint's manifest.

    Args:
      ranges: of the training data. mesh: the scene's cloth, on the device.
    """

    names = ("cloth",)

    def __init__(self, ranges: ClothRanges, mesh: Mesh) -> None:
        self.ranges, self.mesh = ranges, mesh

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def watch(self, states: Cloth, start: Cloth) -> Notice:
        """What there is to say of states [T, B, V, 3] that follow from `start` [B, V, 3]."""
        first = first_marked(self.lost(states, start))
        outside = first_marked(self.outside(states))
        found = torch.cat([first[:, None], outside], dim=1)
        host = np.asarray(found.cpu().numpy(), np.int64)  # one transfer
        return Notice(host[:, 0], np.zeros(len(host), np.int64), host[:, 1:])

    def lost(self, x: Cloth, start: Cloth) -> Tensor:
        """[..., B]: cloths that are none: not finite, faster or more stretched than any can be.

        One that began beyond a bound may stay there, but not go on from there.
        """
        bound = _FAST * max(self.ranges.speed, 1.0)
        speed = start.vel.abs().amax((-1, -2)).mul(1.05).clamp(bound, 10 * bound)
        strain = (_greatest(self.mesh, start) * 1.05).clamp(min=self.ranges.strain + _TORN)
        good = (x.pos.abs() < _FAR).all(-1).all(-1)
        good &= x.vel.abs().amax((-1, -2)) < torch.nan_to_num(speed, bound)
        good &= _greatest(self.mesh, x) < torch.nan_to_num(strain, self.ranges.strain + _TORN)
        return ~good

    def outside(self, x: Cloth) -> Tensor:
        """[..., B, 1]: cloths whose state lies outside the training data."""
        known, height = self.ranges, x.pos[..., 2]
        inside = height.amin(-1) >= known.height[0] - _SLACK
        inside &= height.amax(-1) <= known.height[1] + _SLACK
        inside &= x.vel.norm(dim=-1).amax(-1) <= _BEYOND * known.speed
        inside &= _greatest(self.mesh, x) <= _BEYOND * known.strain
        return ~inside[..., None]

    def calm(self, qpos: Any, qvel: Any) -> bool:
        """Whether there is surely nothing to say of one world: never known without looking."""
        return False

    def concerns(self, x: Cloth) -> list[str]:
        """What of the states [B, V, 3] lies outside the training data, one line each."""
        known, found = self.ranges, []
        low, high = float(x.pos[..., 2].min()), float(x.pos[..., 2].max())
        if not (low >= known.height[0] - _SLACK and high <= known.height[1] + _SLACK):
            found.append(
                f"the cloth is {low:.3g} to {high:.3g} m high (trained on {known.height[0]:.3g} to "
                f"{known.height[1]:.3g})"
            )
        speed, strain = float(x.vel.norm(dim=-1).max()), float(_greatest(self.mesh, x).max())
        if not speed <= _BEYOND * known.speed:
            found.append(f"its speed is {speed:.3g} m/s (trained up to {known.speed:.3g})")
        if not strain <= _BEYOND * known.strain:
            found.append(f"an edge's strain is {strain:.3g} (trained up to {known.strain:.3g})")
        return found

    def concern(self, x: Cloth, world: int, entity: int) -> str:
        """What is the matter with one world of states [B, V, 3]."""
        return "; ".join(self.concerns(x.at(slice(world, world + 1)))) or "its state is no number"


def _greatest(mesh: Mesh, x: Cloth) -> Tensor:
    """[...]: the greatest strain of a cloth's edges."""
    ends = x.pos[..., mesh.edge, :]
    length = (ends[..., 0, :] - ends[..., 1, :]).norm(dim=-1)
    return (length / mesh.rest - 1.0).abs().amax(-1)
