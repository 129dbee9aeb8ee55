"""Writes a checkpoint again in few bits a weight."""

from __future__ import annotations

from pathlib import Path

from orbisim_diffusion.checkpoint import (
    AUTOENCODER,
    DENOISER,
    INFERENCE,
    ONE_STEP,
    PHYSICS,
    save_in_few_bits,
)
from orbisim_diffusion.estimate import load_with_inference
from orbisim_diffusion.estimate_physics import load_physics


def shrink(source: str | Path, target: str | Path, bits: int) -> None:
    """Writes all parts of a checkpoint again with their matrices in few bits.

    Args:
      source, target: folders, which may be one.
      bits: of a weight (see `orbisim_world_model.quantization`).

    Raises:
      InputError: a file is missing or damaged, or no weights have so many bits.
    """
    point, inference = load_with_inference(source)
    known = {
        AUTOENCODER: point.autoencoder,
        DENOISER: point.denoiser,
        ONE_STEP: point.one_step,
        INFERENCE: inference,
        PHYSICS: load_physics(source)[0] if PHYSICS in point.manifest["files"] else None,
    }
    parts = {name: module for name, module in known.items() if module is not None}
    save_in_few_bits(Path(target), parts, point.manifest, bits)
