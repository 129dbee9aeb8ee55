"""Checkpoints: weights in safetensors, fp16 or few bits, a file a part, and their manifest."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from pathlib import Path
from typing import Any

import torch
from orbisim_world_model.plain import checked
from orbisim_world_model.quantization import quantized, read_weights
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from orbisim.errors import InputError
from orbisim.files.reading import read_json, size_of
from orbisim.files.writing import make_folder, write_json, writing
from orbisim_diffusion.autoencoder import Autoencoder
from orbisim_diffusion.conditions import map_channels
from orbisim_diffusion.config import Config
from orbisim_diffusion.denoiser import Denoiser
from orbisim_diffusion.scope import Scope, check_scope

SCHEMA, MANIFEST = "orbisim.vision/1", "manifest.json"
AUTOENCODER, DENOISER, ONE_STEP = "autoencoder", "denoiser", "one_step"
INFERENCE, PHYSICS = "inference", "physics"
"""Names of the parts; the last two are StaInf (`orbisim_diffusion.estimate` reads it) and PhyInf
(`orbisim_diffusion.estimate_physics`)."""
_MOST_PARAMETERS = 2**28
"""A gigabyte; what has been trained has some millions."""
_MOST_WIDTH, _MOST_BLOCKS = 4096, 64


@dataclasses.dataclass(frozen=True, eq=False)
class Checkpoint:
    """A trained model and what is known about it.

    Attributes:
      autoencoder: in evaluation mode, as are the others, float32, on the CPU.
      denoiser: for any number of steps. one_step: tuned for one; None if there is none.
      config, scope: of the model and of its training data.
      manifest: everything else. path: the folder.
    """

    autoencoder: Autoencoder
    denoiser: Denoiser
    one_step: Denoiser | None
    config: Config
    scope: Scope
    manifest: dict[str, Any]
    path: Path


def save_checkpoint(
    folder: Path,
    parts: dict[str, nn.Module],
    config: Config,
    scope: Scope,
    notes: dict[str, Any],
) -> None:
    """Writes parts and manifest; the manifest, which makes a checkpoint of them, comes last."""
    make_folder(folder)
    files = {name: _write_part(folder, name, module) for name, module in parts.items()}
    manifest = {
        "schema": SCHEMA,
        "config": dataclasses.asdict(config),
        "scope": dataclasses.asdict(scope),
        "files": files,
        "parameters": {name: _parameters(module) for name, module in parts.items()},
        **notes,
    }
    write_json(folder / MANIFEST, manifest, announce=False)


def add_part(
    folder: Path,
    name: str,
    module: nn.Module,
    metrics: dict[str, Any],
    reach: dict[str, Any] | None = None,
) -> None:
    """Adds a part to a checkpoint; one of that name is replaced.

    Args:
      folder: of the checkpoint. name: of the part. module: with its weights.
      metrics: what was measured on it.
      reach: what it suits, where that is not what the checkpoint suits.
    """
    manifest = read_manifest(folder)
    changes = {
        "files": _write_part(folder, name, module),
        "parameters": _parameters(module),
        "metrics": metrics,
        **({} if reach is None else {"reach": reach}),
    }
    for key, value in changes.items():
        manifest[key] = {**manifest.get(key, {}), name: value}
    write_json(folder / MANIFEST, manifest, announce=False)


def save_in_few_bits(
    folder: Path, parts: dict[str, nn.Module], manifest: dict[str, Any], bits: int
) -> None:
    """Writes a checkpoint whose matrices have few bits, each weight rounded to the nearest.

    Args:
      folder: where to. parts: by their names. manifest: what else is known of them.
      bits: of a weight (see `orbisim_world_model.quantization`).
    """
    make_folder(folder)
    files = {name: _write_part(folder, name, module, bits) for name, module in parts.items()}
    write_json(folder / MANIFEST, {**manifest, "files": files}, announce=False)


def _write_part(
    folder: Path, name: str, module: nn.Module, bits: int | None = None
) -> dict[str, Any]:
    """What the manifest says of the file; `bits` of a matrix' weights, None for fp16."""
    path = folder / f"{name}.safetensors"
    tensors: dict[str, Tensor] = {}
    for key, tensor in module.state_dict().items():
        if bits is not None and tensor.dim() > 1:
            tensors |= quantized(tensor, bits).tensors(key)
        else:
            tensors[key] = _stored(tensor)
    with writing(path, announce=False) as part:
        save_file(tensors, str(part))
    return {"sha256": digest(path), "bytes": path.stat().st_size}


def _parameters(module: nn.Module) -> int:
    return sum(p.numel() for p in module.parameters())


def read_manifest(folder: str | Path) -> dict[str, Any]:
    """The manifest of a checkpoint.

    Raises:
      InputError: there is none, or it is of another kind.
    """
    path = Path(folder) / MANIFEST
    try:
        manifest = read_json(path)
    except InputError as error:
        raise InputError(f"{folder}: not a checkpoint of a vision model ({error})") from None
    if manifest.get("schema") != SCHEMA:
        raise InputError(f"{path}: not the manifest of a vision model ({SCHEMA})")
    return manifest


def read_config(manifest: dict[str, Any], where: str) -> Config:
    """The configuration, held against bounds before anything is built from it.

    Raises:
      InputError: an entry is missing, unknown, of the wrong type or out of bounds.
    """
    config = checked(Config, manifest.get("config"), f"{where}: config")
    a, d = config.autoencoder, config.denoiser
    sizes = (*a.widths, a.channels, *d.widths, d.token)
    if not (all(1 <= size <= _MOST_WIDTH for size in sizes) and 8 <= config.size <= 2048):
        raise InputError(f"{where}: config: widths are 1 to {_MOST_WIDTH}, images 8 to 2048 pixels")
    if not all(1 <= blocks <= _MOST_BLOCKS for blocks in (a.blocks, d.blocks)):
        raise InputError(f"{where}: config: blocks are 1 to {_MOST_BLOCKS}")
    if d.heads < 1 or d.widths[1] % d.heads:
        raise InputError(f"{where}: config: heads must divide the width {d.widths[1]}")
    if d.left_out and (d.maps != "geometry" or not map_channels(d)):
        raise InputError(
            f"{where}: config: left_out names geometry buffers, of which one at least is left"
        )
    return config


def load_checkpoint(folder: str | Path) -> Checkpoint:
    """Reads a checkpoint.

    Raises:
      InputError: a file is missing, damaged, or another than the manifest's.
    """
    path = Path(folder)
    manifest = read_manifest(path)
    where = str(path / MANIFEST)
    config = read_config(manifest, where)
    scope = checked(Scope, manifest.get("scope"), f"{where}: scope")
    check_scope(scope, f"{where}: scope")
    files = checked(dict[str, Any], manifest.get("files"), f"{where}: files")
    channels = config.autoencoder.channels
    found: dict[str, Any] = {}
    for name in (AUTOENCODER, DENOISER, ONE_STEP):
        if name in files:
            found[name] = load_part(path, name, files[name], _maker(name, config, channels))
    for name in (AUTOENCODER, DENOISER):
        if name not in found:
            raise InputError(f"{where}: files has no entry {name!r}")
    return Checkpoint(
        found[AUTOENCODER],
        found[DENOISER],
        found.get(ONE_STEP),
        config,
        scope,
        manifest,
        path,
    )


def _maker(name: str, config: Config, channels: int) -> Any:
    if name == AUTOENCODER:
        return lambda: Autoencoder(config.autoencoder)
    return lambda: Denoiser(config.denoiser, channels)


def load_part(folder: Path, name: str, entry: Any, make: Any) -> nn.Module:
    """One part: a module of that shape, with the weights of its file.

    Args:
      folder: of the checkpoint. name: of the part. entry: what the manifest says of its file.
      make: builds the module; first without memory, to compare shapes.

    Raises:
      InputError: the file is missing, damaged, or another than the manifest's.
    """
    path = folder / f"{name}.safetensors"
    size_of(path)
    if not isinstance(entry, dict) or entry.get("sha256") != digest(path):
        raise InputError(
            f"{path}: is not the file that the manifest names (its sha256 differs); get both from "
            "one place"
        )
    with torch.device("meta"):
        expected = {n: tuple(t.shape) for n, t in make().state_dict().items()}
    if sum(map(math.prod, expected.values())) > _MOST_PARAMETERS:
        raise InputError(f"{path}: more than {_MOST_PARAMETERS} parameters are not read")
    try:
        tensors = _weights(path, expected)
        module: nn.Module = make()
        module.load_state_dict({n: t.float() for n, t in tensors.items()})
    except (OSError, SafetensorError, InputError, LookupError, ValueError, RuntimeError) as error:
        raise InputError(f"{path}: damaged ({' '.join(str(error).split())[:200]})") from None
    return module.eval().requires_grad_(False)


def _weights(path: Path, expected: dict[str, tuple[int, ...]]) -> dict[str, Tensor]:
    with safe_open(str(path), framework="pt") as file:
        found: dict[str, Tensor] = read_weights(file, {n: n for n in file.keys()}, expected)  # noqa: SIM118
        return found


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    found = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(2**20):
            found.update(piece)
    return found.hexdigest()


def _stored(tensor: Tensor) -> Tensor:
    return tensor.detach().half().cpu().contiguous()
