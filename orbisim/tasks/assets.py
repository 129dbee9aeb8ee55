"""The scenes in `mjcf_assets` that the tasks start from."""

from __future__ import annotations

import functools
from importlib import resources
from pathlib import Path

import mujoco

from orbisim.errors import InputError
from orbisim.scene import Scene


def path(name: str) -> Path:
    """The scene file of an asset folder.

    Raises:
      InputError: it is not installed.
    """
    found = Path(str(resources.files("mjcf_assets"))) / name / "scene.xml"
    if not found.exists():
        raise InputError(f"{found}: no such file; the package is not installed completely")
    return found


@functools.cache
def _read(name: str) -> mujoco.MjSpec:
    return mujoco.MjSpec.from_file(str(path(name)))


def spec(name: str) -> mujoco.MjSpec:
    """An editable copy of an asset's scene."""
    return _read(name).copy()


def scene(edited: mujoco.MjSpec, label: str) -> Scene:
    """The scene of an edited document."""
    return Scene.from_spec(edited, source=label)
