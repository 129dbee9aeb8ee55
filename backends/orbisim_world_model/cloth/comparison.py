"""Several checkpoints of cloths on the same held-out falls."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from orbisim_world_model.cloth.checkpoint import load_cloth
from orbisim_world_model.cloth.data import Falls, read_falls
from orbisim_world_model.cloth.evaluate import BASELINES, HORIZONS, baseline, evaluate_cloth


def compare_cloths(
    folders: Sequence[Path],
    data: Sequence[Path],
    *,
    horizons: Sequence[int] | None = None,
    limit: int = 512,
    device: str = "cpu",
    by_group: bool = False,
    scene: str | None = None,
) -> dict[str, Any]:
    """Errors of checkpoints and of what learned nothing, by group of episodes.

    Args:
      folders: checkpoints. data: episode files.
      horizons: control steps (see `evaluate_cloth`). limit: at most so many episodes.
      device: where to compute. by_group: each subtask by itself beside all together.
      scene: that the episodes of a scene's file were collected in.

    Raises:
      InputError: a checkpoint is of no cloth, or of another one than the episodes.
    """
    falls = read_falls(data, scene)
    falls = falls.subset(torch.arange(min(limit, falls.episodes))).to(device)
    models = {}
    for folder in folders:
        checkpoint = load_cloth(folder, falls.mesh)
        name = str(checkpoint.manifest["config"]["name"])
        models[f"{name} ({folder.name})" if name in models else name] = checkpoint.model.to(device)
    models |= {name: baseline(name, falls.mesh).to(device) for name in BASELINES}
    parts = {"all": falls, **(_groups(falls) if by_group else {})}
    return {
        "schema": "orbisim.eval/1",
        "burn": 0,
        "control_timestep": falls.mesh.timestep,
        "parameters": {n: sum(p.numel() for p in m.parameters()) for n, m in models.items()},
        "groups": {
            group: {
                name: evaluate_cloth(model, part, horizons or HORIZONS)
                for name, model in models.items()
            }
            for group, part in parts.items()
        },
    }


def _groups(falls: Falls) -> dict[str, Falls]:
    """The episodes of each subtask."""
    return {
        name: falls.subset(torch.nonzero(falls.group == number)[:, 0])
        for number, name in enumerate(falls.notes["groups"])
        if bool((falls.group == number).any())
    }
