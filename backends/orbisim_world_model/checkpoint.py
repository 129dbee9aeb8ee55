"""Checkpoints: weights in safetensors, half precision or few bits, with a JSON manifest."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
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
from orbisim_world_model.quantization import Quantized, read_weights

WEIGHTS = "model.safetensors"
_VARIANT = "variant."
_MOST_PARAMETERS = 2**28
"""A gigabyte; what has been trained has some millions."""

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


def save_checkpoint(
    folder: Path,
    models: Sequence[Dynamics],
    manifest: dict[str, Any],
    matrices: Sequence[Mapping[str, Quantized]] = (),
) -> None:
    """Writes a checkpoint; a reader never sees half of one.

    Args:
      folder: where to.
      models: one for each robot; those after the first share all but the robot's parts with it.
      manifest: what is known of them; `variants` has an entry for each model after the first.
      matrices: those of each model that are stored in few bits, by their names.
    """
    make_folder(folder)
    model = models[0]
    tensors: dict[str, Tensor] = {}
    first = model.state_dict()
    for number, each in enumerate(models):
        prefix = f"{_VARIANT}{number}." if number else ""
        few = matrices[number] if matrices else {}
        for name, tensor in each.state_dict().items():
            if name in few:
                tensors |= few[name].tensors(prefix + name)
            elif not (number and _is_shared(name) and _same(first.get(name), tensor)):
                exact = tensor.detach().cpu().contiguous()  # vectors: they cost little
                tensors[prefix + name] = exact if few else _stored(name, tensor)
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
    write_parts(folder, tensors, header)


def write_parts(folder: Path, tensors: dict[str, Tensor], header: dict[str, Any]) -> None:
    """Writes weights and manifest; a reader never sees half of them."""
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
        if theirs.articulated and layout.articulated:
            return load_checkpoint(folder, layout, number)
        robot = (theirs.robot, theirs.nu, bool(theirs.objects), bool(theirs.parts)) == (
            layout.robot,
            layout.nu,
            bool(layout.objects),
            bool(layout.parts),
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
        tensors = stored_weights(Path(folder) / WEIGHTS, variant, shapes)
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
    controls = layout.nu if layout.articulated else int(manifest["controls"])
    model = Dynamics(layout, config).build(controls)
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


def stored_weights(path: Path, variant: int, expected: dict[str, Any]) -> dict[str, Tensor]:
    """The weights of one robot's model, if they are those that are expected.

    Raises:
      InputError: they have other names, shapes or types, or are not finite.
    """
    size_of(path)
    with safe_open(str(path), framework="pt") as file:
        stored = _of_variant({name: name for name in file.keys()}, variant, expected)  # noqa: SIM118
        try:
            return read_weights(file, stored, expected)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None


def _of_variant(tensors: dict[str, T], variant: int, expected: Mapping[str, Any]) -> dict[str, T]:
    """What there is of one robot's model, by the names in it: its own, and what it shares with the
    first of the parts that it has (objects, or parts of mechanisms)."""
    plain = {n: t for n, t in tensors.items() if not n.startswith(_VARIANT)}
    if not variant:
        return plain
    prefix = f"{_VARIANT}{variant}."
    own = {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}
    has = [part for part in SHARED if any(_within(name, part) for name in expected)]
    shared = {n: t for n, t in plain.items() if any(_within(n, part) for part in has)}
    return shared | own


def _is_shared(name: str) -> bool:
    return any(_within(name, part) for part in SHARED)


def _within(name: str, part: str) -> bool:
    return name == part or name.startswith(f"{part}.")


def _same(first: Tensor | None, tensor: Tensor) -> bool:
    """Whether this is the first model's own tensor."""
    return first is not None and first.data_ptr() == tensor.data_ptr()


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
        "joints": _columns(
            tuple(layout.joints[j] for j in layout.robot_joints), x.q[:, list(layout.robot_joints)]
        ),
        "joint_speed": _largest(x.v),
        "object_position": _columns(tuple("xyz"), x.pos[there]),
        "object_speed": _largest(x.vel),
        "object_turning": _largest(x.ang),
        "objects": [int(pack.mask.sum(1).min()), int(pack.mask.sum(1).max())],
    }
    if layout.parts:
        count = pack.part_mask.sum(1)
        found["parts"] = _columns(layout.part_columns, pack.parts[pack.part_mask > 0])
        found["parts"]["count"] = [float(count.min()), float(count.max())]
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
