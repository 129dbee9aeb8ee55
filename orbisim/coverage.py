"""Intervals that a backend predicts of its own errors, beside these errors."""

from __future__ import annotations

import dataclasses
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim import metrics
from orbisim.backend import Intervals

Floats = npt.NDArray[np.float64]
UNITS = {"position": "m", "rotation": "rad"}


@dataclasses.dataclass(frozen=True)
class Coverage:
    """Predicted and true errors of K frames along T times of rollouts.

    Attributes:
      intervals: what was predicted.
      position: [nworld, T, K] true distances, m. rotation: [nworld, T, K] true geodesic distances
        on SO(3), rad. NaN where either state is not finite.
    """

    intervals: Intervals
    position: Floats
    rotation: Floats

    def predicted(self, quantity: str) -> Floats:
        """Half-widths [nworld, T, K] of the intervals; quantity: one of `UNITS`."""
        return np.asarray(getattr(self.intervals, quantity))

    def error(self, quantity: str) -> Floats:
        """True errors [nworld, T, K]; quantity: one of `UNITS`."""
        return np.asarray(getattr(self, quantity))

    def held(self, quantity: str) -> Floats:
        """[nworld, T, K]: 1 where an interval holds the error, else 0; NaN without an error."""
        error = self.error(quantity)
        known = np.isfinite(error)
        return np.where(known, self.predicted(quantity) >= np.where(known, error, 0.0), np.nan)

    def to_json(self) -> dict[str, Any]:
        """`orbisim compare --json`'s `uncertainty` of one side."""
        return {
            "level": self.intervals.level,
            "frames": [
                {"kind": kind, "name": name}
                | {quantity: self._row(quantity, number) for quantity in UNITS}
                for number, (kind, name) in enumerate(self.intervals.frames)
            ],
        }

    def _row(self, quantity: str, frame: int) -> dict[str, Any]:
        held = self.held(quantity)[..., frame]
        return {
            "unit": UNITS[quantity],
            "interval": _summary(self.predicted(quantity)[..., frame]),
            "error": _summary(self.error(quantity)[..., frame]),
            "covered": _plain([_mean(held[:, t]) for t in range(held.shape[1])]),
            "covered_in_all": _plain([_mean(held)])[0],
        }


def coverage(model: mujoco.MjModel, intervals: Intervals, qpos: Floats, truth: Floats) -> Coverage:
    """Predicted intervals beside the true errors.

    Args:
      model: of the scene. intervals: of the states qpos [nworld, T, nq].
      truth: [nworld, T, nq] what the states should have been.
    """
    place, turn = metrics.poses(model, qpos, intervals.frames)
    there, turned = metrics.poses(model, truth, intervals.frames)
    distance = np.linalg.norm(place - there, axis=-1)
    return Coverage(intervals, distance, metrics.rotation_angle(turn, turned))


def _summary(values: Floats) -> dict[str, Any]:
    median, p95 = metrics.quantiles(values)
    return {"median": _plain(median), "p95": _plain(p95)}


def _mean(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else np.nan


def _plain(values: list[float]) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in values]
