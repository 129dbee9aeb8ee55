"""Names of the episode format, version 1 (docs/episodes.md)."""

from __future__ import annotations

SCHEMA = "orbisim.episodes/1"

PER_STEP = frozenset({"ctrl", "action"})
"""Datasets with T rows; all others that run over time have T + 1."""

IMAGES = ("frames/", "depth/", "segmentation/")
"""Beginnings of the names of datasets with an image for each time."""

STATIC_PREFIXES = ("descriptor/", "entities/")
"""Datasets that do not run over time."""


def is_static(name: str) -> bool:
    """Whether a dataset does not run over time."""
    return name.startswith(STATIC_PREFIXES)
