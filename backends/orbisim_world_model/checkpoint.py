"""Checkpoints: fp16 weights in safetensors with a JSON manifest beside them."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor
from torch.nn import ModuleList

from orbisim.errors import InputError
from orbisim_world_model.config import ModelConfig
from orbisim_world_model.dynamics import SHARED, Dynamics
from orbisim_world_model.layout import Layout
from orbisim_world_model.pack import Pack

SCHEMA = "orbisim.dynamics/1"
WEIGHTS, MANIFEST = "model.safetensors", "manifest.json"
_VARIANT = "variant."


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


def save_checkpoint(folder: Path, models: Sequence[Dynamics], manifest: dict[str, Any]) -> None:
    """Writes a checkpoint; a reader never sees half of one.

    Args:
      folder: where to.
      models: one for each robot; those after the first share all but the robot's parts with it.
      manifest: what is known of them; `variants` has an entry for each model after the first.
    """
    folder.mkdir(parents=True, exist_ok=True)
    model = models[0]
    tensors = {name: _stored(name, tensor) for name, tensor in model.state_dict().items()}
    for number, other in enumerate(models[1:], 1):
        for name, tensor in other.state_dict().items():
            if not _is_shared(name):
                tensors[f"{_VARIANT}{number}.{name}"] = _stored(name, tensor)
    header = {
        "schema": SCHEMA,
        "model": dataclasses.asdict(model.config),
        "controls": model.controls,
        "layout": model.layout.to_dict(),
        "parameters": sum(p.numel() for p in ModuleList(models).parameters()),
        **manifest,
    }
    for entry, other in zip(header.get("variants", []), models[1:], strict=True):
        entry.update(layout=other.layout.to_dict(), controls=other.controls)
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


def variants(manifest: dict[str, Any]) -> list[dict[str, Any]]:
    """The manifest as it is for each robot that the checkpoint knows."""
    views = [manifest]
    for entry in manifest.get("variants", []):
        data = {**manifest["data"], "robot": entry["robot"]}
        own = {name: entry[name] for name in ("layout", "controls", "ranges")}
        views.append({**manifest, **own, "data": data})
    return views


def load_for(folder: str | Path, layout: Layout) -> Checkpoint:
    """Reads a checkpoint for data of a layout: its robot, and its number of objects.

    Raises:
      InputError: the checkpoint knows no such robot, or only another number of objects.
    """
    manifest = read_manifest(folder)
    known = []
    for number, view in enumerate(variants(manifest)):
        theirs = Layout.from_dict(view["layout"])
        robot = (theirs.joints, theirs.nu, bool(theirs.objects)) == (
            layout.joints,
            layout.nu,
            bool(layout.objects),
        )
        count = len(theirs.objects) == len(layout.objects) or view["model"]["kind"] == "objects"
        if robot and count and abs(theirs.timestep - layout.timestep) < 1e-9:
            return load_checkpoint(folder, layout, number)
        known.append(_summary(theirs))
    raise InputError(
        f"{folder}: trained on {' and on '.join(known)}; the episodes have {_summary(layout)}"
    )


def _summary(layout: Layout) -> str:
    return (
        f"{len(layout.joints)} joints, {len(layout.objects)} objects, {layout.nu} controls and "
        f"steps of {layout.timestep:g} s"
    )


def load_checkpoint(
    folder: str | Path, layout: Layout | None = None, variant: int = 0
) -> Checkpoint:
    """Reads a checkpoint.

    Args:
      folder: where it is.
      variant: which of the robots that it knows.
      layout: of a scene with another number of objects than it was trained on; the weights of an
        object-centric model do not depend on that number.

    Raises:
      InputError: a file is missing or damaged, or the weights do not fit the manifest.
    """
    manifest = read_manifest(folder)
    try:
        manifest = variants(manifest)[variant]
        config = ModelConfig(**manifest["model"])
        layout = layout or Layout.from_dict(manifest["layout"])
        model = Dynamics(layout, config).build(int(manifest["controls"]))
        tensors = _of_variant(load_file(str(Path(folder) / WEIGHTS)), variant)
        model.load_state_dict({name: tensor.float() for name, tensor in tensors.items()})
    except (OSError, SafetensorError, KeyError, IndexError, TypeError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{folder}: a damaged checkpoint ({reason})") from None
    return Checkpoint(model.eval(), manifest, Path(folder))


def _of_variant(tensors: dict[str, Tensor], variant: int) -> dict[str, Tensor]:
    """The weights of one robot's model, by their names in it."""
    plain = {n: t for n, t in tensors.items() if not n.startswith(_VARIANT)}
    if not variant:
        return plain
    prefix = f"{_VARIANT}{variant}."
    own = {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}
    return {n: t for n, t in plain.items() if _is_shared(n)} | own


def _is_shared(name: str) -> bool:
    return any(name == part or name.startswith(f"{part}.") for part in SHARED)


def ranges(pack: Pack) -> dict[str, Any]:
    """What the data cover: descriptors and sizes of states, by column."""
    present = pack.mask > 0
    attributes = pack.attributes[present]
    layout = pack.layout
    row, episode = pack.transitions(50_000)
    x, there = pack.states(row), pack.mask[episode] > 0
    found: dict[str, Any] = {
        "attributes": _columns(layout.attributes, attributes),
        "settings": _columns(layout.settings, pack.world),
        "joints": _columns(layout.joints, x.q),
        "joint_speed": _largest(x.v),
        "object_position": _columns(tuple("xyz"), x.pos[there]),
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
