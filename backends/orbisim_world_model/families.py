"""Which kind of learned model a checkpoint is, and how each is read and stepped.

`orbisim.dynamics/1` knows robots, rigid objects and parts of mechanisms; `orbisim.cloth/1` a cloth
over what stands still.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from orbisim.errors import InputError
from orbisim.files.reading import read_json
from orbisim.scene import Scene
from orbisim_world_model.checkpoint import load_checkpoint
from orbisim_world_model.cloth.checkpoint import load_cloth
from orbisim_world_model.cloth.engine import ClothEngine
from orbisim_world_model.cloth.fitting import ClothFit, fit_cloth
from orbisim_world_model.cloth.manifest import CLOTH_SCHEMA, read_cloth_manifest
from orbisim_world_model.engine import Engine
from orbisim_world_model.fitting import Fit, fit
from orbisim_world_model.manifest import MANIFEST, read_manifest
from orbisim_world_model.stepper import Speedups
from orbisim_world_model.stepping import Stepping

AnyFit = Fit | ClothFit


def is_cloth(folder: str | Path) -> bool:
    """Whether a checkpoint is of a cloth; False where there is none that can be read."""
    try:
        found = read_json(Path(folder) / MANIFEST)
    except InputError:
        return False
    return isinstance(found, dict) and found.get("schema") == CLOTH_SCHEMA


def read_any(folder: str | Path) -> dict[str, Any]:
    """The manifest of a checkpoint of any kind.

    Raises:
      InputError: there is none, or an entry is not what it must be.
    """
    return read_cloth_manifest(folder) if is_cloth(folder) else read_manifest(folder)


def fit_any(manifest: dict[str, Any], scene: Scene) -> AnyFit:
    """Checks a scene against the manifest of a checkpoint of any kind.

    Raises:
      UnsupportedSceneError: the checkpoint cannot step this scene.
    """
    if manifest["schema"] == CLOTH_SCHEMA:
        return fit_cloth(manifest, scene)
    return fit(manifest, scene)


def engine_for(folder: Path, found: AnyFit, device: torch.device, speedups: Speedups) -> Stepping:
    """A checkpoint that fits, on a device.

    Raises:
      InputError: it cannot be read.
    """
    if isinstance(found, ClothFit):
        return ClothEngine(load_cloth(folder, found.layout), device)
    checkpoint = load_checkpoint(folder, found.layout, found.variant)
    return Engine(checkpoint, device, speedups)
