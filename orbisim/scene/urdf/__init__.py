"""URDF: parsed by yourdfpy, built into `mujoco.MjSpec`.

Where MuJoCo's own import of a file succeeds, masses, inertias, axes, anchors, limits and forward
kinematics agree with it. What it cannot read (packages, COLLADA, several parts, missing inertia)
this reader can.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from orbisim.scene.files import contents
from orbisim.scene.reading import Reader, ReadResult
from orbisim.scene.urdf.build import build
from orbisim.scene.urdf.document import read_document
from orbisim.scene.urdf.options import UrdfOptions, urdf_options

__all__ = ["UrdfOptions", "UrdfReader", "read_urdf", "read_urdf_string"]


class UrdfReader(Reader):
    """URDF files and strings."""

    format = "URDF"
    suffix = ".urdf"
    root = "robot"

    def read(self, path: str, **options: Any) -> ReadResult:
        """See `read_urdf`."""
        return read_urdf(path, **options)

    def read_string(self, text: str, **options: Any) -> ReadResult:
        """See `read_urdf_string`."""
        return read_urdf_string(text, **options)


def read_urdf(path: str, **options: Any) -> ReadResult:
    """Reads a URDF file.

    Args:
      path: the file.
      **options: see `UrdfOptions`.

    Raises:
      SceneError: the file, or a file that it names, is missing or broken.
      InputError: an option is wrong.
      MissingDependencyError: yourdfpy is not installed.
    """
    chosen = urdf_options(options)
    data = contents(Path(path))
    return build(read_document(data, str(path)), Path(path).parent, chosen, str(path))


def read_urdf_string(
    text: str,
    *,
    base_folder: str | os.PathLike[str] | None = None,
    source: str = "URDF string",
    **options: Any,
) -> ReadResult:
    """Reads URDF given as a string.

    Args:
      text: the document.
      base_folder: where its relative file names start; the working directory by default.
      source: what errors call the document.
      **options: see `UrdfOptions`.

    Raises:
      SceneError: as `read_urdf`.
    """
    chosen = urdf_options(options)
    folder = None if base_folder is None else Path(base_folder)
    return build(read_document(text, source), folder, chosen, source)
