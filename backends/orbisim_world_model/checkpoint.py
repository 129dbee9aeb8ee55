"""Checkpoints: fp16 weights in safetensors with a JSON manifest beside them."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from orbisim.errors import InputError
from orbisim_world_model.config import ModelConfig
from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.layout import Layout
from orbisim_world_model.pack import Pack

SCHEMA = "orbisim.dynamics/1"
WEIGHTS, MANIFEST = "model.safetensors", "manifest.json"


@dataclasses.dataclass(frozen=True, eq=False)
class Checkpoint:
    """A trained model and what is known about it.

    Attributes:
      model: in evaluation mode, float32, on the CPU.
      manifest: configuration, layout, normalisation, ranges, training data, versions, metrics.
      path: the folder.
    """

    model: Dynamics
    manifest: dict[str, Any]
    path: Path

    @property
    def layout(self) -> Layout:
        """Of the scenes that it was trained on."""
        return self.model.layout


def save_checkpoint(folder: Path, model: Dynamics, manifest: dict[str, Any]) -> None:
    """Writes a checkpoint; a reader never sees half of one."""
    folder.mkdir(parents=True, exist_ok=True)
    tensors = {name: _stored(name, tensor) for name, tensor in model.state_dict().items()}
    header = {
        "schema": SCHEMA,
        "model": dataclasses.asdict(model.config),
        "controls": model.controls,
        "layout": model.layout.to_dict(),
        "parameters": sum(p.numel() for p in model.parameters()),
        **manifest,
    }
    save_file(tensors, str(folder / f"{WEIGHTS}.part"))
    (folder / f"{MANIFEST}.part").write_text(json.dumps(header, indent=1))
    for name in (WEIGHTS, MANIFEST):
        (folder / f"{name}.part").replace(folder / name)


def read_manifest(folder: str | Path) -> dict[str, Any]:
    """The manifest of a checkpoint.

    Raises:
      InputError: there is none, or it is of another kind.
    """
    path = Path(folder) / MANIFEST
    try:
        manifest: dict[str, Any] = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"{folder}: not a checkpoint of learned dynamics ({error})") from None
    if not isinstance(manifest, dict) or manifest.get("schema") != SCHEMA:
        raise InputError(f"{path}: not the manifest of learned dynamics ({SCHEMA})")
    return manifest


def load_checkpoint(folder: str | Path, layout: Layout | None = None) -> Checkpoint:
    """Reads a checkpoint.

    Args:
      folder: where it is.
      layout: of a scene with another number of objects than it was trained on; the weights of an
        object-centric model do not depend on that number.

    Raises:
      InputError: a file is missing or damaged, or the weights do not fit the manifest.
    """
    manifest = read_manifest(folder)
    try:
        config = ModelConfig(**manifest["model"])
        layout = layout or Layout.from_dict(manifest["layout"])
        model = Dynamics(layout, config).build(int(manifest["controls"]))
        tensors = load_file(str(Path(folder) / WEIGHTS))
        model.load_state_dict({name: tensor.float() for name, tensor in tensors.items()})
    except (OSError, SafetensorError, KeyError, TypeError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{folder}: a damaged checkpoint ({reason})") from None
    return Checkpoint(model.eval(), manifest, Path(folder))


def ranges(pack: Pack) -> dict[str, Any]:
    """What the data cover: descriptors and sizes of states, by column."""
    present = pack.mask > 0
    attributes = pack.attributes[present]
    layout = pack.layout
    x = pack.states(pack.transitions(50_000)[0])
    found: dict[str, Any] = {
        "attributes": _columns(layout.attributes, attributes),
        "settings": _columns(layout.settings, pack.world),
        "joints": _columns(layout.joints, x.q),
        "joint_speed": _largest(x.v),
        "object_position": _columns(tuple("xyz"), x.pos.reshape(-1, 3)),
        "object_speed": _largest(x.vel),
        "object_turning": _largest(x.ang),
        "objects": [int(pack.mask.sum(1).min()), int(pack.mask.sum(1).max())],
    }
    return found


def _columns(names: tuple[str, ...], rows: Tensor) -> dict[str, list[float]]:
    if not len(rows):
        return {}
    low, high = rows.amin(0).tolist(), rows.amax(0).tolist()
    return {name: [a, b] for name, a, b in zip(names, low, high, strict=True)}


def _largest(values: Tensor) -> float:
    return float(values.abs().max()) if values.numel() else 0.0


def _stored(name: str, tensor: Tensor) -> Tensor:
    """Weights in half precision; scales and means as they are."""
    half = name.startswith("network.") and tensor.dtype == torch.float32
    return (tensor.half() if half else tensor).detach().cpu().contiguous()
