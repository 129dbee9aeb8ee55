"""The checkpoints that come with the package."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from orbisim.errors import UnsupportedSceneError
from orbisim.scene import Scene
from orbisim_world_model.fitting import Fit, fit
from orbisim_world_model.manifest import MANIFEST, read_manifest

FOLDER = Path(__file__).parent / "zoo"


@functools.cache
def entries(folder: Path) -> dict[str, dict[str, Any]]:
    """Manifests of the checkpoints in a folder, by name."""
    return {path.parent.name: read_manifest(path.parent) for path in folder.glob(f"*/{MANIFEST}")}


def find(scene: Scene, baseline: str = "none") -> tuple[Path, Fit]:
    """The checkpoint that fits a scene best, and how it fits.

    One whose training data include the scene's task comes first, then the one with the fewest
    concerns.

    Raises:
      UnsupportedSceneError: none fits.
    """
    fits: list[tuple[tuple[bool, int, str], Path, Fit]] = []
    reasons: dict[str, str] = {}
    for name, manifest in entries(FOLDER).items():
        if manifest["model"].get("baseline", "none") != baseline:
            continue
        try:
            found = fit(manifest, scene)
        except UnsupportedSceneError as error:
            reasons[name] = error.problem
            continue
        tasks = {source.get("task") for source in manifest["data"].get("sources", [])}
        rank = (scene.source not in tasks, len(found.concerns), name)
        fits.append((rank, FOLDER / name, found))
    if not fits:
        raise UnsupportedSceneError(scene.source, _none(reasons))
    _, path, found = min(fits, key=lambda entry: entry[0])
    return path, found


def _none(reasons: dict[str, str]) -> str:
    known = ", ".join(sorted(reasons)) or "none"
    detail = "".join(f"; {name}: {reason}" for name, reason in list(reasons.items())[:1])
    return (
        f"no checkpoint of the zoo fits it (there are: {known}{detail}); "
        "train one (orbisim train dynamics) and name it, as in learned:PATH"
    )
