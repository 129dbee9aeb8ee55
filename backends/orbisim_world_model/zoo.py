"""The checkpoints that come with the package."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from orbisim.errors import InputError, UnsupportedSceneError
from orbisim.scene import Scene
from orbisim_world_model.families import AnyFit, fit_any, read_any
from orbisim_world_model.manifest import MANIFEST

FOLDER = Path(__file__).parent / "zoo"


@functools.cache
def entries(folder: Path) -> dict[str, dict[str, Any]]:
    """Manifests of the checkpoints in a folder, by name."""
    return {path.parent.name: read_any(path.parent) for path in folder.glob(f"*/{MANIFEST}")}


def located(checkpoint: str | Path) -> Path:
    """The folder of a checkpoint; the zoo's of that name, if there is no such folder.

    Raises:
      InputError: there is neither; of a path with several parts, whoever reads it says so.
    """
    path, known = Path(checkpoint), entries(FOLDER)
    if path.exists() or len(path.parts) > 1:
        return path
    if str(checkpoint) in known:
        return FOLDER / path
    raise InputError(
        f"{checkpoint}: no such folder, and the zoo has no checkpoint of that name "
        f"({', '.join(sorted(known))})"
    )


def find(scene: Scene, baseline: str = "none") -> tuple[Path, AnyFit]:
    """The checkpoint that fits a scene best, and how it fits.

    One whose training data include the scene's task comes first, then one of the scene's own robot
    before one of any robot, then the one with the fewest concerns, then the one that was trained on
    the fewest tasks.

    Raises:
      UnsupportedSceneError: none fits; with what keeps those from it that were trained on its task,
        or know any robot.
    """
    fits: list[tuple[tuple[bool, bool, int, int, str], Path, AnyFit]] = []
    known: list[str] = []
    reasons: dict[str, str] = {}
    for name, manifest in entries(FOLDER).items():
        if manifest["model"].get("baseline", "none") != baseline:
            continue
        known.append(name)
        of_all = bool(manifest["model"].get("articulated"))
        tasks = {source.get("task") for source in manifest["data"].get("sources", [])}
        try:
            found = fit_any(manifest, scene)
        except UnsupportedSceneError as error:
            if of_all or scene.source in tasks:  # why those of other robots do not fit is no news
                reasons[name] = error.problem
            continue
        rank = (scene.source not in tasks, of_all, len(found.concerns), len(tasks), name)
        fits.append((rank, FOLDER / name, found))
    if not fits:
        raise UnsupportedSceneError(scene.source, _none(known, reasons))
    _, path, found = min(fits, key=lambda entry: entry[0])
    return path, found


def _none(known: list[str], reasons: dict[str, str]) -> str:
    there = ", ".join(sorted(known)) or "none"
    detail = "".join(f"; {name}: {reason}" for name, reason in reasons.items())
    return (
        f"no checkpoint of the zoo fits it (there are: {there}{detail}); train one with orbisim "
        "collect and orbisim train dynamics, and name it, as in learned:PATH (docs/own-robot.md)"
    )
