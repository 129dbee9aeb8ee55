"""Checkpoints: fp16 or 8-bit weights in safetensors with a JSON manifest beside them."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor
from torch.nn import ModuleList

from orbisim.errors import InputError
from orbisim.files.reading import size_of
from orbisim.files.writing import make_folder, writing
from orbisim_world_model.config import ModelConfig
from orbisim_world_model.dynamics import SHARED, Dynamics
from orbisim_world_model.layout import Layout
from orbisim_world_model.manifest import MANIFEST, SCHEMA, model_config, read_manifest, variants
from orbisim_world_model.pack import Pack

WEIGHTS = "model.safetensors"
_VARIANT = "variant."
_MOST_PARAMETERS = 2**28
"""A gigabyte; what has been trained has some millions."""
_TYPES = ("F16", "BF16", "F32", "F64")
_FACTORS = ".factors"
"""After the name of a matrix that is stored in 8 bits: what its groups are multiplied by."""
_GROUP = 32
"""Weights of a row with one factor: fewer cost space, more are rounded more coarsely."""

T = TypeVar("T")


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
    make_folder(folder)
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
    with (
        writing(folder / MANIFEST, announce=False) as manifest_part,
        writing(folder / WEIGHTS, announce=False) as weights,  # the first to appear
    ):
        save_file(tensors, str(weights))
        manifest_part.write_text(json.dumps(header, indent=1))


def load_for(folder: str | Path, layout: Layout) -> Checkpoint:
    """Reads a checkpoint for data of a layout: its robot, and its number of objects.

    Raises:
      InputError: the checkpoint knows no such robot, or only another number of objects.
    """
    manifest = read_manifest(folder)
    known = []
    for number, view in enumerate(variants(manifest)):
        theirs = Layout.from_dict(view["layout"], f"{folder}: layout")
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
    views = variants(manifest)
    if not 0 <= variant < len(views):
        raise InputError(f"{folder}: knows {len(views)} robots; there is none of number {variant}")
    manifest, path = views[variant], str(Path(folder) / MANIFEST)
    config = model_config(manifest, path)
    layout = layout or Layout.from_dict(manifest["layout"], f"{path}: layout")
    try:
        shapes = _shapes(layout, config, manifest)
        tensors = _weights(Path(folder) / WEIGHTS, variant, shapes)
        model = _built(layout, config, manifest)
        model.load_state_dict({name: tensor.float() for name, tensor in tensors.items()})
    except InputError:
        raise
    except (OSError, SafetensorError, LookupError, ValueError, TypeError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{folder}: a damaged checkpoint ({reason})") from None
    return Checkpoint(model.eval(), manifest, Path(folder))


def _built(layout: Layout, config: ModelConfig, manifest: dict[str, Any]) -> Dynamics:
    """An untrained model as a manifest describes it."""
    model = Dynamics(layout, config).build(int(manifest["controls"]))
    known = manifest.get("uncertainty")
    return model if known is None else model.with_spread(int(known["width"]))


def _shapes(layout: Layout, config: ModelConfig, manifest: dict[str, Any]) -> dict[str, Any]:
    """Shapes of the weights that a manifest calls for, without giving memory to them."""
    with torch.device("meta"):
        model = _built(layout, config, manifest)
    shapes = {name: tuple(tensor.shape) for name, tensor in model.state_dict().items()}
    count = sum(map(math.prod, shapes.values()))
    if count > _MOST_PARAMETERS:
        raise ValueError(f"it describes {count} parameters; at most {_MOST_PARAMETERS} are read")
    return shapes


def _weights(path: Path, variant: int, expected: dict[str, Any]) -> dict[str, Tensor]:
    """The weights of one robot's model, if they are those that are expected.

    Raises:
      InputError: they have other names, shapes or types, or are not finite.
    """
    size_of(path)
    with safe_open(str(path), framework="pt") as file:
        stored = _of_variant({name: name for name in file.keys()}, variant)  # noqa: SIM118
        scaled = {name for name in expected if name + _FACTORS in stored}
        scales = {name: file.get_tensor(stored.pop(name + _FACTORS)) for name in scaled}
        for name in sorted(stored.keys() ^ expected.keys()):
            what = "is not in the weights" if name in expected else "is not in the model"
            raise InputError(f"{path}: {name} {what} that the manifest describes")
        for name, key in stored.items():
            part = file.get_slice(key)
            types = ("I8",) if name in scaled else _TYPES
            if tuple(part.get_shape()) != expected[name] or part.get_dtype() not in types:
                raise InputError(
                    f"{path}: {name} is {part.get_dtype()} of shape {tuple(part.get_shape())}; "
                    f"the manifest describes {expected[name]}"
                )
        tensors = {name: file.get_tensor(key) for name, key in stored.items()}
    for name, factors in scales.items():
        tensors[name] = _from_8_bits(path, name, tensors[name], factors)
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise InputError(f"{path}: {name} is not finite")
    return tensors


def _of_variant(tensors: dict[str, T], variant: int) -> dict[str, T]:
    """What there is of one robot's model, by the names in it."""
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


def save_in_8_bits(source: str | Path, target: str | Path) -> None:
    """Writes a checkpoint again with 8 bits a weight, about half of its size.

    Each 32 weights of a row of a matrix are stored as integers of -127 to 127 and one float32
    factor, the largest of them over 127 (rounding to nearest): a weight is off by a 254th of that
    largest at most. Vectors stay as they are.

    Args:
      source, target: folders, which may be one. What else there is in `source` is not copied.

    Raises:
      InputError: a file is missing or damaged.
    """
    load_checkpoint(source)  # what it says about damage is clearer than what follows would
    tensors: dict[str, Tensor] = {}
    with safe_open(str(Path(source) / WEIGHTS), framework="pt") as file:
        for name in file.keys():  # noqa: SIM118
            tensor = file.get_tensor(name)
            if tensor.dim() < 2 or tensor.dtype != torch.float16 or name.endswith(_FACTORS):
                tensors[name] = tensor
                continue
            groups = _grouped(tensor.float())
            largest = groups.abs().amax(-1)
            factors = torch.where(largest > 0, largest, 1.0) / 127
            whole = torch.round(groups / factors[..., None])
            tensors[name] = _ungrouped(whole, tensor.shape).to(torch.int8).contiguous()
            tensors[name + _FACTORS] = factors
    header = (Path(source) / MANIFEST).read_text()
    make_folder(Path(target))
    with (
        writing(Path(target) / MANIFEST, announce=False) as manifest_part,
        writing(Path(target) / WEIGHTS, announce=False) as weights,
    ):
        save_file(tensors, str(weights))
        manifest_part.write_text(header)


def _from_8_bits(path: Path, name: str, whole: Tensor, factors: Tensor) -> Tensor:
    groups = _grouped(whole.float())
    if factors.shape != groups.shape[:-1] or not factors.is_floating_point():
        raise InputError(
            f"{path}: {name + _FACTORS} is {factors.dtype} of shape {tuple(factors.shape)}; it "
            f"must have one number for each {_GROUP} weights: shape {tuple(groups.shape[:-1])}"
        )
    return _ungrouped(groups * factors.float()[..., None], whole.shape)


def _grouped(matrix: Tensor) -> Tensor:
    """[rows, groups, 32] of a matrix [rows, ...]; the last group is filled with zeros."""
    rows = matrix.flatten(1)
    return torch.nn.functional.pad(rows, (0, -rows.shape[1] % _GROUP)).unflatten(1, (-1, _GROUP))


def _ungrouped(groups: Tensor, shape: torch.Size) -> Tensor:
    return groups.flatten(1)[:, : math.prod(shape[1:])].reshape(shape)


def _stored(name: str, tensor: Tensor) -> Tensor:
    """Weights in half precision; scales and means as they are."""
    half = name.startswith("network.") and tensor.dtype == torch.float32
    return (tensor.half() if half else tensor).detach().cpu().contiguous()
