"""Errors of learned cloths on held-out falls, by horizon."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from orbisim_world_model.cloth.config import ClothModel
from orbisim_world_model.cloth.data import Falls
from orbisim_world_model.cloth.dynamics import ClothDynamics, rolled
from orbisim_world_model.cloth.mesh import Cloth, Mesh
from orbisim_world_model.cloth.solids import nearest

HORIZONS = (1, 10, 30, 100)
"""Steps at which errors are reported: those of `tools/drape_metrics.py`."""
BASELINES: dict[str, ClothModel] = {
    **{kind: ClothModel(kind, projections=0) for kind in ("copy", "constant_velocity")},
    "known": ClothModel("ballistic", projections=100),
}
"""Copy, constant velocity; and free fall with edges' lengths, contacts and friction, of which
nothing is learned: 100 projections, since more hardly change it."""


def baseline(name: str, mesh: Mesh) -> ClothDynamics:
    """A model of `BASELINES`."""
    return ClothDynamics(BASELINES[name], mesh).eval()


@torch.no_grad()  # type: ignore[untyped-decorator]
def evaluate_cloth(
    model: ClothDynamics, falls: Falls, horizons: Sequence[int] = HORIZONS
) -> dict[str, Any]:
    """Errors of a model that sees nothing but the first state of each episode.

    Args:
      model: on the falls' device, of their cloth.
      falls: held-out episodes.
      horizons: numbers of control steps; those that the episodes do not have are left out.

    Returns:
      For each horizon and quantity its median, mean, 90 % and 95 % quantile and largest value over
      vertices (edges) and episodes: `vertex_position` (mm), `vertex_velocity` (mm/s),
      `penetration` (mm) of vertices with the cloth's radius, and `strain` (%) of edges, its size.
      `penetration` and `strain` of the episodes themselves are under `true_`.
    """
    steps = [h for h in horizons if h <= falls.steps]
    if not steps:
        return {}
    path = rolled(model, falls.x.at((slice(None), 0)), falls.solids, max(steps))
    found: dict[str, Any] = {}
    for horizon in steps:
        x, truth = path.at(horizon - 1), falls.x.at((slice(None), horizon))
        values = {
            "vertex_position": (x.pos - truth.pos).norm(dim=-1) * 1e3,
            "vertex_velocity": (x.vel - truth.vel).norm(dim=-1) * 1e3,
            "penetration": penetration(falls, x) * 1e3,
            "strain": strain(falls.mesh, x.pos) * 1e2,
            "true_penetration": penetration(falls, truth) * 1e3,
            "true_strain": strain(falls.mesh, truth.pos) * 1e2,
        }
        found[str(horizon)] = {name: summary(v) for name, v in values.items()}
        found[str(horizon)]["episodes"] = falls.episodes
    return found


def penetration(falls: Falls, x: Cloth) -> Tensor:
    """[episodes, V]: how deep each vertex, with the cloth's radius, is in what stands there, m."""
    return (falls.mesh.radius - nearest(falls.solids, x.pos).distance).clamp_min(0.0)


def strain(mesh: Mesh, places: Tensor) -> Tensor:
    """[..., E]: size of the change of each edge's length over its length at rest; vertices
    [..., V, 3]."""
    ends = places[..., mesh.edge, :]
    return ((ends[..., 0, :] - ends[..., 1, :]).norm(dim=-1) / mesh.rest - 1.0).abs()


def summary(values: Tensor) -> dict[str, float]:
    """Median, mean, quantiles and largest value of an array; infinite where one is no number."""
    flat = torch.nan_to_num(values.double().flatten(), nan=torch.inf).sort().values
    at = {"median": 0.5, "p90": 0.9, "p95": 0.95, "worst": 1.0}
    picked = {name: float(flat[round(q * (len(flat) - 1))]) for name, q in at.items()}
    return {"mean": float(flat.mean()), **picked}
