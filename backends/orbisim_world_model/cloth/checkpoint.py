"""Checkpoints of learned cloth: weights in safetensors, half precision or few bits, with a JSON
manifest."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError

from orbisim.errors import InputError
from orbisim.files.writing import make_folder
from orbisim_world_model.checkpoint import WEIGHTS, stored_weights, write_parts
from orbisim_world_model.cloth.config import ClothModel
from orbisim_world_model.cloth.dynamics import ClothDynamics
from orbisim_world_model.cloth.manifest import CLOTH_SCHEMA, cloth_model, read_cloth_manifest
from orbisim_world_model.cloth.mesh import Mesh


@dataclasses.dataclass(frozen=True, eq=False)
class ClothCheckpoint:
    """A trained model and what is known about it.

    Attributes:
      model: in evaluation mode, float32, on the CPU.
      manifest: configuration, ranges, training data, versions, metrics.
      path: the folder.
    """

    model: ClothDynamics
    manifest: dict[str, Any]
    path: Path

    @property
    def layout(self) -> Mesh:
        """The cloth that the model was read for."""
        return self.model.mesh


def save_cloth(folder: Path, model: ClothDynamics, manifest: dict[str, Any]) -> None:
    """Writes a checkpoint; a reader never sees half of one."""
    make_folder(folder)
    tensors = {name: tensor.detach().cpu() for name, tensor in model.state_dict().items()}
    stored = {
        name: (tensor.half() if name.startswith("network.") else tensor).contiguous()
        for name, tensor in tensors.items()
    }
    header = {
        "schema": CLOTH_SCHEMA,
        "model": dataclasses.asdict(model.config),
        "parameters": sum(p.numel() for p in model.parameters()),
        **manifest,
    }
    write_parts(folder, stored, header)


def load_cloth(folder: str | Path, mesh: Mesh) -> ClothCheckpoint:
    """Reads a checkpoint for a cloth (see `fitting.fit_cloth` for whether it fits).

    Raises:
      InputError: a file is missing or damaged, or the weights do not fit the manifest.
    """
    manifest = read_cloth_manifest(folder)
    config = cloth_model(manifest, str(folder))
    try:
        tensors = stored_weights(Path(folder) / WEIGHTS, 0, _shapes(config, mesh))
        model = ClothDynamics(config, mesh)
        model.load_state_dict({name: tensor.float() for name, tensor in tensors.items()})
    except InputError:
        raise
    except (OSError, SafetensorError, LookupError, ValueError, TypeError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{folder}: a damaged checkpoint of a cloth ({reason})") from None
    return ClothCheckpoint(model.eval(), manifest, Path(folder))


def _shapes(config: ClothModel, mesh: Mesh) -> dict[str, tuple[int, ...]]:
    """Shapes of the weights that a configuration calls for, without giving memory to them."""
    with torch.device("meta"):
        model = ClothDynamics(config, mesh)
    return {name: tuple(tensor.shape) for name, tensor in model.state_dict().items()}
