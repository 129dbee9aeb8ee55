"""`Guard`: notices worlds that diverge and states that were never seen in training."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbisim_world_model.entities import Entities
from orbisim_world_model.layout import Layout

_FAST, _FAR, _BEYOND = 100.0, 1e4, 2.0
"""Times the largest speed in training, and metres, at which a world counts as diverged; times the
largest speed in training from which on a warning is due."""


class Guard:
    """Limits from the manifest of a checkpoint.

    Args:
      manifest: of the checkpoint. layout: of the scene.
    """

    def __init__(self, manifest: dict[str, Any], layout: Layout) -> None:
        self.ranges, self.layout = manifest["ranges"], layout
        speeds = ("joint_speed", "object_speed", "object_turning")
        self.limits = [_FAST * max(float(self.ranges[name]), 1.0) for name in speeds]

    def diverged_at(self, states: Entities) -> npt.NDArray[np.int64]:
        """[B]: the first of the states [T, B, ...] that is not usable, -1 for none."""
        with torch.no_grad():
            good = torch.ones(states.pos.shape[:2], dtype=torch.bool, device=states.pos.device)
            rows = zip((states.v, states.vel, states.ang), self.limits, strict=True)
            places = ((states.pos, _FAR), (states.q, _FAR), (states.act, _FAR))
            for values, limit in (*rows, *places):
                if values.numel():  # a comparison with NaN is false
                    good &= (values.abs() < limit).flatten(2).all(-1)
            at = torch.where(good.all(0), -1, good.to(torch.int8).argmin(0))
        return np.asarray(at.cpu().numpy(), np.int64)

    def lost(self, qpos: Any, qvel: Any) -> bool:
        """Whether one world's coordinates [1, nq], [1, nv] are not usable."""
        fast = max(self.limits)
        return not (np.abs(qpos).max(initial=0) < _FAR and np.abs(qvel).max(initial=0) < fast)

    def concerns(self, x: Entities) -> list[str]:
        """What of the states [B, ...] lies outside the training data, one line each."""
        found = []
        for index, name in enumerate(self.layout.joints):
            if self.layout.bounded[index]:
                found += self._outside(
                    f"joint {name!r}", x.q[:, index], self.ranges["joints"][name]
                )
        for axis, bounds in self.ranges["object_position"].items():
            if axis == "z" or not self.layout.invariant:
                values = x.pos[..., "xyz".index(axis)]
                found += self._outside(f"an object's {axis}", values, bounds)
        speeds = {"joint_speed": x.v, "object_speed": x.vel, "object_turning": x.ang}
        for name, values in speeds.items():
            largest = float(values.abs().max()) if values.numel() else 0.0
            if largest > _BEYOND * float(self.ranges[name]) + 1e-3:
                what = name.replace("_", " ")
                found.append(f"{what} is {largest:.3g} (trained up to {self.ranges[name]:.3g})")
        return found

    def _outside(self, what: str, values: Tensor, bounds: list[float]) -> list[str]:
        if not values.numel():
            return []
        low, high = bounds
        slack = 0.05 * (high - low) + 1e-3
        least, most = float(values.min()), float(values.max())
        if low - slack <= least and most <= high + slack:
            return []
        value = least if least < low - slack else most
        return [f"{what} is at {value:.3g} (trained on {low:.3g} to {high:.3g})"]


def blanked(states: Entities, diverged_at: npt.NDArray[np.int64]) -> Entities:
    """States [T, B, ...] with NaN from where a world diverged."""
    if not (diverged_at >= 0).any():
        return states
    device = states.pos.device
    first = torch.as_tensor(diverged_at, device=device)
    steps = torch.arange(states.pos.shape[0], device=device)
    gone = (first >= 0) & (steps[:, None] >= first)  # [T, B]

    def blank(field: Tensor) -> Tensor:
        return field.masked_fill(gone.reshape(*gone.shape, *([1] * (field.dim() - 2))), torch.nan)

    return Entities(*map(blank, states))
