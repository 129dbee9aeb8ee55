"""Several checkpoints on the same held-out episodes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from orbisim_world_model.checkpoint import Checkpoint, load_for
from orbisim_world_model.cloth.comparison import compare_cloths
from orbisim_world_model.evaluate import BURN, HORIZONS, constant_velocity, evaluate
from orbisim_world_model.families import is_cloth
from orbisim_world_model.manifest import read_manifest
from orbisim_world_model.pack import Pack
from orbisim_world_model.packing import read_data, with_limbs


def compare_checkpoints(
    folders: Sequence[Path],
    data: Sequence[Path],
    *,
    horizons: Sequence[int] | None = None,
    burn: int = BURN,
    limit: int = 512,
    device: str = "cpu",
    by_group: bool = False,
    scene: str | None = None,
) -> dict[str, Any]:
    """Errors of checkpoints and of constant velocity, by group of episodes.

    Args:
      folders: checkpoints; the first one's kind of state is constant velocity's too. Those of
        cloths are compared by `cloth.comparison.compare_cloths`, without `burn`.
      data: episode files or packs.
      horizons, burn, limit: see `evaluate`.
      device: where to compute.
      by_group: each subtask by itself beside all together.
      scene: that the episodes of a scene's file were collected in.

    Raises:
      InputError: the episodes are of another scene than a checkpoint.
    """
    if is_cloth(folders[0]):
        return compare_cloths(
            folders,
            data,
            horizons=horizons,
            limit=limit,
            device=device,
            by_group=by_group,
            scene=scene,
        )
    baseline = str(read_manifest(folders[0])["model"].get("baseline", "none"))
    pack = read_data(data, baseline=baseline, scene=scene).to(device)
    checkpoints = [load_for(folder, _seen(folder, pack, scene).layout) for folder in folders]
    parts = {"all": pack}
    if by_group:
        for number, name in enumerate(pack.notes["groups"]):
            chosen = torch.nonzero(pack.group == number)[:, 0]
            if len(chosen):
                parts[name] = pack.subset(chosen)
    steps = horizons or HORIZONS
    groups: dict[str, Any] = {}
    for name, part in parts.items():
        found = {
            _name(c, checkpoints): evaluate(
                c.model.to(part.device),
                _seen(c.path, part, scene),
                steps,
                burn=burn,
                limit=limit,
            )
            for c in checkpoints
        }
        still = constant_velocity(part, checkpoints[0].model.config)
        found["constant_velocity"] = evaluate(still, part, steps, burn=burn, limit=limit)
        groups[name] = found
    return {
        "schema": "orbisim.eval/1",
        "burn": burn,
        "control_timestep": pack.layout.timestep,
        "parameters": {_name(c, checkpoints): c.manifest["parameters"] for c in checkpoints},
        "groups": groups,
    }


def _seen(folder: Path, pack: Pack, scene: str | None) -> Pack:
    """The episodes as a checkpoint sees them."""
    limbs = read_manifest(folder)["model"].get("articulated")
    return with_limbs(pack, scene) if limbs else pack


def _name(checkpoint: Checkpoint, among: Sequence[Checkpoint]) -> str:
    """The configuration's name; with the folder's where two have the same."""
    own = str(checkpoint.manifest["config"]["name"])
    alike = sum(str(c.manifest["config"]["name"]) == own for c in among)
    return own if alike == 1 else f"{own} ({checkpoint.path.name})"
