"""The manifest of a checkpoint of learned cloth, checked before anything is built from it."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from orbisim.errors import InputError
from orbisim.files.reading import read_json
from orbisim_world_model.cloth.config import ClothModel
from orbisim_world_model.manifest import MANIFEST
from orbisim_world_model.plain import checked

CLOTH_SCHEMA = "orbisim.cloth/1"
_MOST = {"width": 4096, "layers": 64, "codes": 4096, "projections": 1000}
"""Of a model's sizes: far beyond what has been trained (width 128, 4 layers, 48 codes)."""
_MOST_VERTICES = 100_000
"""Of a cloth: far beyond what C MuJoCo steps at all."""


@dataclasses.dataclass(frozen=True)
class ClothRanges:
    """What the training data cover, lowest and highest.

    Attributes:
      vertices: number of them. edge: their lengths at rest, m. mass: of a vertex, kg. radius: m.
      gravity: its size, m/s^2. sliding: friction of cloth and things. height: of vertices, m.
      speed: largest of a vertex, m/s. strain: largest of an edge.
    """

    vertices: tuple[int, int]
    edge: tuple[float, float]
    mass: tuple[float, float]
    radius: tuple[float, float]
    gravity: tuple[float, float]
    sliding: tuple[float, float]
    height: tuple[float, float]
    speed: float
    strain: float


def read_cloth_manifest(folder: str | Path) -> dict[str, Any]:
    """The manifest of a checkpoint.

    Raises:
      InputError: there is none, it is of another kind, or an entry is not what it must be.
    """
    path = Path(folder) / MANIFEST
    try:
        manifest = read_json(path)
    except InputError as error:
        raise InputError(f"{folder}: not a checkpoint of a learned cloth ({error})") from None
    if not isinstance(manifest, dict) or manifest.get("schema") != CLOTH_SCHEMA:
        raise InputError(f"{path}: not the manifest of a learned cloth ({CLOTH_SCHEMA})")
    cloth_model(manifest, str(path))
    ranges = cloth_ranges(manifest, str(path))
    if not 1 <= ranges.vertices[0] <= ranges.vertices[1] <= _MOST_VERTICES:
        raise InputError(f"{path}: ranges.vertices is {list(ranges.vertices)}; expected 1 to "
                         f"{_MOST_VERTICES}")  # fmt: skip
    step = checked(float, _entry(manifest, "control_timestep", path), f"{path}: control_timestep")
    if not step > 0:
        raise InputError(f"{path}: control_timestep is {step:g}; expected a time above 0 s")
    checked(int, manifest.get("parameters", 0), f"{path}: parameters")
    sources = _entry(_entry(manifest, "data", path), "sources", path)
    if not isinstance(sources, list) or not all(isinstance(one, dict) for one in sources):
        raise InputError(f"{path}: data.sources: expected a list of objects")
    for source in sources:
        checked(str, source.get("task", ""), f"{path}: data.sources, task")
    return manifest


def cloth_model(manifest: dict[str, Any], where: str) -> ClothModel:
    """What the model is.

    Raises:
      InputError: an entry is of the wrong type, unknown, or out of bounds.
    """
    config = checked(ClothModel, _entry(manifest, "model", where), f"{where}: model")
    for name, most in _MOST.items():
        value, least = getattr(config, name), 0 if name == "projections" else 1
        if not least <= value <= most:
            raise InputError(f"{where}: model.{name} is {value}; expected {least} to {most}")
    return config


def cloth_ranges(manifest: dict[str, Any], where: str) -> ClothRanges:
    """What the training data cover.

    Raises:
      InputError: an entry is missing or of the wrong type.
    """
    return checked(ClothRanges, _entry(manifest, "ranges", where), f"{where}: ranges")


def _entry(values: Any, name: str, where: Any) -> Any:
    if not isinstance(values, dict) or name not in values:
        raise InputError(f"{where}: has no entry {name!r}")
    return values[name]
