"""Mesh files: checked before any parser sees them, and loaded through trimesh.

`check_mesh_file` finds what would crash or fool a parser: a header that claims more than the file
holds, coordinates that are not finite, faces that name vertices that do not exist. It reads
STL, OBJ and MuJoCo's binary MSH with numpy; the other formats are loaded and the result checked.
What each format's header must say is in `orbisim.scene.safety.meshformats`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh

from orbisim.scene.safety.meshcheck import Blame, check_native_mesh
from orbisim.scene.safety.meshformats import CHECKED_WHOLE, CHECKS, check_presence
from orbisim.scene.safety.meshparse import MeshFile, MeshPart, join, parse_mesh_file

__all__ = [
    "MeshFile",
    "MeshPart",
    "check_mesh_file",
    "join",
    "load_mesh",
    "load_mesh_file",
    "scaled",
    "to_msh",
]


def check_mesh_file(
    path: str | Path, *, source: str | None = None, element: str | None = None
) -> None:
    """Refuses a mesh file that is broken or hostile.

    Args:
      path: the file.
      source: the scene that refers to it, for the message; the mesh file itself by default.
      element: the element of the scene that refers to it.

    Raises:
      SceneError: the file is missing or empty, its suffix is unknown, it is too large, its header
        claims more than it holds, a vertex is not finite, or a face names no vertex.
    """
    path = Path(path)
    if path.suffix.lower() in CHECKED_WHOLE:
        check_native_mesh(path, source=source, element=element)
        return
    with Blame(path, source, element):
        check_presence(path)
        CHECKS[path.suffix.lower()](path)
        parse_mesh_file(path)


def load_mesh_file(
    path: str | Path, *, source: str | None = None, element: str | None = None
) -> MeshFile:
    """Loads and checks a mesh file with all its nodes, transforms, units and colours.

    COLLADA's unit is applied and its up axis ignored, as robot descriptions expect.

    Raises:
      SceneError: as `check_mesh_file`.
    """
    path = Path(path)
    with Blame(path, source, element):
        check_presence(path)
        CHECKS[path.suffix.lower()](path)
        return parse_mesh_file(path)


def load_mesh(path: str | Path, scale: float | Sequence[float] = 1.0) -> trimesh.Trimesh:
    """A mesh file as one mesh: every node in its place, in metres, times `scale`.

    Vertices and faces keep the order of the file.

    Raises:
      SceneError: as `check_mesh_file`.
    """
    return scaled(load_mesh_file(path).joined(), scale)


def scaled(mesh: trimesh.Trimesh, scale: float | Sequence[float]) -> trimesh.Trimesh:
    """A scaled copy; a mirrored one is turned inside out again so that normals point outwards."""
    factors = np.broadcast_to(np.asarray(scale, np.float64), 3)
    faces = mesh.faces[:, ::-1] if np.prod(factors) < 0 else mesh.faces
    return trimesh.Trimesh(mesh.vertices * factors, faces, process=False)


def to_msh(mesh: trimesh.Trimesh) -> bytes:
    """MuJoCo's binary mesh format: four counts, then vertices and faces.

    Source: the format as documented under `asset/mesh` in MuJoCo's XML reference.
    """
    counts = np.array([len(mesh.vertices), 0, 0, len(mesh.faces)], "<i4")
    vertices, faces = mesh.vertices.astype("<f4"), mesh.faces.astype("<i4")
    return bytes(counts.tobytes() + vertices.tobytes() + faces.tobytes())
