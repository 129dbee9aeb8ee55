"""Whether a checkpoint of learned cloth fits a scene, and what lies outside its training data."""

from __future__ import annotations

import dataclasses
from typing import Any

import torch

from orbisim.errors import UnsupportedSceneError
from orbisim.scene import Scene
from orbisim_world_model.cloth.manifest import cloth_model, cloth_ranges
from orbisim_world_model.cloth.mesh import Mesh, read_mesh
from orbisim_world_model.cloth.solids import Solids, read_solids

_SLACK = 0.02
"""How far, relative to a range's width and its numbers' size, a value may lie outside it."""


@dataclasses.dataclass(frozen=True, eq=False)
class ClothFit:
    """How a checkpoint fits a scene.

    Attributes:
      layout: the scene's cloth. solids: what stands there.
      concerns: what lies outside the training data, one line each.
      variant: 0; other learned models know several robots.
    """

    layout: Mesh
    solids: Solids
    concerns: tuple[str, ...]
    variant: int = 0


def fit_cloth(manifest: dict[str, Any], scene: Scene) -> ClothFit:
    """Checks a scene against a checkpoint's manifest.

    Raises:
      UnsupportedSceneError: the checkpoint cannot step this scene.
    """
    model, step = scene.model, float(manifest["control_timestep"])
    mesh = read_mesh(model, step, scene.source)
    steps = step / float(model.opt.timestep)
    if abs(steps - round(steps)) > 1e-6 * steps or round(steps) < 1:
        raise UnsupportedSceneError(
            scene.source,
            f"the checkpoint's control step is {step:g} s, which is not a multiple of the scene's "
            f"timestep of {model.opt.timestep:g} s",
        )
    known = cloth_ranges(manifest, scene.source)
    if cloth_model(manifest, scene.source).kind == "shape" and (
        known.vertices != (mesh.vertices, mesh.vertices)
    ):
        raise UnsupportedSceneError(
            scene.source,
            f"the checkpoint knows the shapes of cloths of {known.vertices[0]} vertices; the "
            f"scene's has {mesh.vertices}",
        )
    solids = read_solids(model, scene.source)
    return ClothFit(mesh, solids, tuple(_concerns(manifest, scene, mesh, solids)))


def cloth_properties(mesh: Mesh, solids: Solids) -> dict[str, tuple[float, float]]:
    """Lowest and highest of what a scene's cloth is, by names of `ClothRanges`."""

    def ends(values: torch.Tensor) -> tuple[float, float]:
        return float(values.min()), float(values.max())

    return {
        "vertices": (mesh.vertices, mesh.vertices),
        "edge": ends(mesh.rest),
        "mass": ends(mesh.mass),
        "radius": (mesh.radius, mesh.radius),
        "gravity": ends(mesh.gravity.norm()[None]),
        "sliding": ends(solids.sliding),
    }


def _concerns(manifest: dict[str, Any], scene: Scene, mesh: Mesh, solids: Solids) -> list[str]:
    known, concerns = cloth_ranges(manifest, scene.source), []
    for name, (low, high) in cloth_properties(mesh, solids).items():
        least, most = getattr(known, name)
        slack = _SLACK * (most - least) + 1e-3 * max(abs(least), abs(most))
        if low < least - slack or high > most + slack:
            concerns.append(
                f"the cloth's {name} is {low:.4g} to {high:.4g} (trained on {least:.4g} to "
                f"{most:.4g})"
            )
    if mesh.gravity[:2].abs().max() > 1e-6:
        concerns.append("gravity is not along z, as it was in training")
    return concerns
