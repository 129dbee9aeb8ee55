"""Mesh files parsed by trimesh, with all nodes, transforms, units and colours."""

from __future__ import annotations

import dataclasses
import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt
import trimesh
from trimesh.resolvers import Resolver

from orbisim.errors import SceneError
from orbisim.scene.safety.collada import prepare
from orbisim.scene.safety.confine import resolve_inside
from orbisim.scene.safety.meshformats import (
    STL_FACE,
    STL_HEADER,
    check_counts,
    check_faces,
    check_vertices,
    stl_face_count,
)
from orbisim.scene.safety.objfile import obj_vertices
from orbisim.scene.safety.problem import MeshProblemError


@dataclasses.dataclass(frozen=True)
class MeshPart:
    """One piece of a mesh file, in the file's own frame, in metres.

    Attributes:
      mesh: vertices and faces as they stand in the file.
      rgba: its colour, if the file gives one.
    """

    mesh: trimesh.Trimesh
    rgba: tuple[float, float, float, float] | None


@dataclasses.dataclass(frozen=True)
class MeshFile:
    """What a mesh file holds.

    Attributes:
      parts: one for each node that has geometry, node transforms applied.
      textured: whether it refers to images, which are not loaded.
      notes: what had to be assumed.
    """

    parts: tuple[MeshPart, ...]
    textured: bool = False
    notes: tuple[str, ...] = ()

    def joined(self) -> trimesh.Trimesh:
        """All parts as one mesh."""
        return join([part.mesh for part in self.parts])


def join(meshes: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Several meshes as one, without colours."""
    counts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, counts[:-1], strict=True)]
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    return trimesh.Trimesh(vertices, np.concatenate(faces), process=False)


def parse_mesh_file(path: Path) -> MeshFile:
    """Parses a file whose header was checked (`orbisim.scene.safety.meshformats`).

    Raises:
      MeshProblemError: it cannot be read, or a vertex or face is broken.
    """
    try:
        return _parsed(path)
    except (MeshProblemError, SceneError, MemoryError, OSError):
        raise
    except Exception as error:  # parsers of six formats: whatever they raise, the file is broken
        raise MeshProblemError(f"cannot be read ({_described(error)})") from None


def _described(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]


def _parsed(path: Path) -> MeshFile:
    suffix = path.suffix.lower()
    if suffix == ".msh":
        return MeshFile((MeshPart(_load_msh(path), None),))
    if suffix == ".stl" and (count := stl_face_count(path)) is not None:
        return MeshFile((MeshPart(_load_binary_stl(path, count), None),))
    if suffix == ".obj" and (hull := _hull_of_vertices(path)) is not None:
        return MeshFile((MeshPart(hull, None),))
    resolver = _Neighbours(path)
    if suffix != ".dae":
        with path.open("rb") as file:
            scene = _parse(file, suffix[1:], resolver)
        parts = _parts(scene, 1.0)
        return MeshFile(parts, resolver.asked_for_images or _has_image(scene))
    collada = prepare(path)
    scene, notes = _parse_collada(collada.document, path.name, resolver)
    if collada.up_axis != "Z_UP":
        notes = (
            *notes,
            f"mesh {path.name!r} has the up axis {collada.up_axis}, which is ignored: "
            "its axes are used as they are",
        )
    return MeshFile(_parts(scene, collada.metres), collada.textured, notes)


def _parse(file: IO[bytes], suffix: str, resolver: Resolver, **options: Any) -> trimesh.Scene:
    return trimesh.load(
        file, file_type=suffix, resolver=resolver, force="scene", process=False, **options
    )


def _parse_collada(
    document: bytes, name: str, resolver: Resolver
) -> tuple[trimesh.Scene, tuple[str, ...]]:
    """The scene with all of its parts, or else what could be read of it, and a note."""
    try:
        return _parse(io.BytesIO(document), "dae", resolver, ignore_broken=False), ()
    except (SceneError, MemoryError):
        raise
    except Exception as error:
        scene = _parse(io.BytesIO(document), "dae", resolver, ignore_broken=True)
        return scene, (f"mesh {name!r}: broken parts are left out ({_described(error)})",)


def _parts(scene: trimesh.Scene, unit: float) -> tuple[MeshPart, ...]:
    """The meshes of a scene, each in its place, in metres."""
    parts = []
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        geometry = scene.geometry[name]
        if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
            parts.append(MeshPart(_placed(geometry, transform, unit), _rgba(geometry)))
    vertices = sum(len(part.mesh.vertices) for part in parts)
    check_counts(vertices=vertices, faces=sum(len(part.mesh.faces) for part in parts))
    return tuple(parts)


def _load_binary_stl(path: Path, count: int) -> trimesh.Trimesh:
    """Three vertices of its own for every triangle; bytes after the last one do not count."""
    triangles = np.fromfile(path, STL_FACE, count, offset=STL_HEADER)["vertices"]
    vertices = triangles.reshape(-1, 3).astype(np.float64)
    return trimesh.Trimesh(vertices, np.arange(3 * count).reshape(-1, 3), process=False)


def _load_msh(path: Path) -> trimesh.Trimesh:
    data = path.read_bytes()
    nvert, nnormal, ntexcoord, nface = (int(n) for n in np.frombuffer(data, "<i4", 4))
    vertices = np.frombuffer(data, "<f4", 3 * nvert, 16).reshape(-1, 3)
    if nface == 0:
        return trimesh.convex.convex_hull(vertices.astype(np.float64))
    faces = np.frombuffer(data, "<i4", 3 * nface, 16 + 12 * (nvert + nnormal) + 8 * ntexcoord)
    return trimesh.Trimesh(vertices, faces.reshape(-1, 3), process=False)


_OBJ_FACE = re.compile(rb"^[ \t]*f[ \t]", re.MULTILINE)


def _hull_of_vertices(path: Path) -> trimesh.Trimesh | None:
    """The convex hull of an OBJ file without faces, as MuJoCo takes it; None if it has some."""
    data = path.read_bytes()
    return None if _OBJ_FACE.search(data) else trimesh.convex.convex_hull(obj_vertices(data))


def _placed(
    geometry: trimesh.Trimesh, transform: npt.NDArray[np.float64], unit: float
) -> trimesh.Trimesh:
    """A copy in the frame of the file, in metres, checked."""
    vertices = np.asarray(geometry.vertices, np.float64)
    if vertices.shape[1:] != (3,) or geometry.faces.shape[1:] != (3,):
        raise MeshProblemError("has vertices or faces that do not consist of three numbers")
    check_faces(geometry.faces, len(vertices))
    placed = (vertices @ transform[:3, :3].T + transform[:3, 3]) * unit
    check_vertices(placed)
    mirrored = np.linalg.det(transform[:3, :3]) < 0
    faces = geometry.faces[:, ::-1] if mirrored else geometry.faces
    return trimesh.Trimesh(placed, faces, process=False)


def _rgba(geometry: trimesh.Trimesh) -> tuple[float, float, float, float] | None:
    """The one colour of a part, if it has one."""
    material = getattr(geometry.visual, "material", None)
    if material is not None:
        color = np.asarray(material.main_color, np.float64) / 255
    elif geometry.visual.kind == "face":
        colors = np.unique(geometry.visual.face_colors, axis=0)
        color = colors[0] / 255 if len(colors) == 1 else np.empty(0)
    else:
        return None
    if color.shape != (4,):
        return None
    red, green, blue, alpha = (float(x) for x in color)
    return red, green, blue, alpha


def _has_image(scene: trimesh.Scene) -> bool:
    """Whether an image stands in the file itself (binary glTF)."""
    for geometry in scene.geometry.values():
        material = getattr(geometry.visual, "material", None)
        if getattr(material, "baseColorTexture", None) is not None:
            return True
        if getattr(material, "image", None) is not None:
            return True
    return False


class _Neighbours(Resolver):
    """Gives a parser the material libraries beside a mesh file, and nothing else.

    Images are not loaded; `asked_for_images` says whether there are any.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.asked_for_images = False

    def get(self, name: str) -> bytes:
        """The bytes of a material library."""
        file = resolve_inside(name.strip(), self._path.parent, source=str(self._path), element=name)
        if file.suffix.lower() == ".mtl" and file.is_file() and file.stat().st_size < 2**24:
            return file.read_bytes()
        self.asked_for_images |= file.suffix.lower() != ".mtl"
        raise FileNotFoundError(name)

    def keys(self) -> list[str]:
        """Nothing can be listed."""
        return []

    def namespaced(self, namespace: str) -> Resolver:
        """The same: names are relative to the mesh file."""
        return self

    def write(self, name: str, data: Any) -> None:
        """Refused."""
        raise PermissionError(name)
