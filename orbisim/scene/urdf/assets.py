"""Mesh files as assets that the scene carries along."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import trimesh

from orbisim.errors import SceneError
from orbisim.files.guard import opened
from orbisim.scene.safety.meshcheck import check_native_mesh
from orbisim.scene.safety.meshes import (
    MeshFile,
    join,
    load_mesh_file,
    scaled,
    to_msh,
)
from orbisim.scene.safety.meshformats import (
    STL_FACE,
    STL_HEADER,
    stl_face_count,
)
from orbisim.scene.urdf.inertia import legacy
from orbisim.scene.urdf.model import Array, Rgba, Shape
from orbisim.scene.urdf.packages import FileFinder

FLAT_THICKNESS = 1e-3
"""m, of a flat collision mesh: MuJoCo collides convex hulls, and a plane figure has none."""

_FLAT = 1e-6
"""Smallest over largest extent below which a mesh is flat."""

_DECODED = (".stl", ".obj", ".msh")
"""MuJoCo has decoders for these."""

_STL_MOST_FACES = 200_000
"""MuJoCo's STL decoder takes no more."""

_LEAST_VOLUME = 1e-14
"""m^3; MuJoCo takes no mesh with less than a tenth of it, unless it is weighed as a shell."""

_FEWEST_VERTICES = 4
"""MuJoCo takes no mesh with fewer."""


class Meshes:
    """The mesh assets of a scene.

    Every file is read once, checked, and put into the spec's own assets: the scene can be saved
    and compiled again when the files are gone.
    """

    def __init__(self, spec: mujoco.MjSpec, finder: FileFinder, source: str) -> None:
        self._spec, self._finder, self._source = spec, finder, source
        self._loaded: dict[Path, MeshFile] = {}
        self._keys: dict[Path, str] = {}
        self._added: dict[tuple[Path, tuple[float, ...], bool], list[tuple[str, Rgba | None]]] = {}
        self._names: set[str] = set()
        self._files: set[str] = set()
        self._assets: dict[str, bytes] = {}
        self.notes: dict[str, None] = {}
        self.textured: dict[str, None] = {}

    def triangles(self, shape: Shape) -> trimesh.Trimesh:
        """The mesh of a shape, all parts together, scaled."""
        loaded = self._load(self._finder.find(shape.file, shape.label), shape)
        return scaled(loaded.joined(), shape.scale)

    def collision(self, shape: Shape) -> str:
        """Name of the mesh asset of a collision shape: one solid."""
        path = self._finder.find(shape.file, shape.label)
        key = (path, shape.scale, False)
        if key not in self._added:
            asset = self._add(path.stem, self._solid(path, shape), shape)
            if _has_no_volume(self.triangles(shape)):
                asset.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            self._added[key] = [(asset.name, None)]
        return self._added[key][0][0]

    def visual(self, shape: Shape) -> Sequence[tuple[str, Rgba | None]]:
        """Names of the mesh assets of a visual shape, one for each colour in the file."""
        path = self._finder.find(shape.file, shape.label)
        key = (path, shape.scale, True)
        if key not in self._added:
            self._added[key] = [
                (self._add_shell(path.stem, file, shape), rgba)
                for file, rgba in self._painted(path, shape)
            ]
        return self._added[key]

    def finish(self) -> None:
        """Hands the files to the spec."""
        self._spec.assets = self._assets

    def _solid(self, path: Path, shape: Shape) -> str:
        """File for a collision shape: as it is, or converted, or made thick if it is flat."""
        native = self._native(path, shape)
        mesh = self._load(path, shape).joined()
        normal = _normal_if_flat(mesh)
        if normal is None:
            return native or self._converted(path.stem, mesh, shape)
        thickness = FLAT_THICKNESS / float(np.min(np.abs(shape.scale)))
        self.notes[
            f"{shape.label}: mesh {path.name!r} is flat; made {FLAT_THICKNESS:g} m thick to collide"
        ] = None
        return self._converted(path.stem, _thick(mesh, thickness * normal), shape)

    def _painted(self, path: Path, shape: Shape) -> list[tuple[str, Rgba | None]]:
        """Files for the parts of a mesh file, by colour."""
        if not _may_have_colors(path):
            native = self._native(path, shape)
            if native and not self._is_tiny(path, shape):
                return [(native, None)]
        loaded = self._load(path, shape)
        if loaded.textured:
            self.textured[path.name] = None
        groups: dict[Rgba | None, list[trimesh.Trimesh]] = {}
        for part in loaded.parts:
            groups.setdefault(part.rgba, []).append(part.mesh)
        return [
            (self._converted(path.stem, _at_least_four(join(meshes)), shape), rgba)
            for rgba, meshes in groups.items()
        ]

    def _load(self, path: Path, shape: Shape) -> MeshFile:
        if path not in self._loaded:
            opened(path)
            loaded = load_mesh_file(path, source=self._source, element=shape.label)
            self._loaded[path] = loaded
            self.notes.update(dict.fromkeys(loaded.notes))
        return self._loaded[path]

    def _is_tiny(self, path: Path, shape: Shape) -> bool:
        size = path.stat().st_size
        return size < 1024 and len(self._load(path, shape).joined().vertices) < 16

    def _native(self, path: Path, shape: Shape) -> str | None:
        """Key of the file as it is, if MuJoCo reads it; None if it must be converted."""
        if path in self._keys or path.suffix.lower() not in _DECODED:
            return self._keys.get(path)
        opened(path)
        found = check_native_mesh(path, source=self._source, element=shape.label)
        data = None if found.several_objects else _as_mujoco_reads_it(path)
        if data is None:
            return None
        self._keys[path] = self._store(path.name, data)
        return self._keys[path]

    def _converted(self, stem: str, mesh: trimesh.Trimesh, shape: Shape) -> str:
        if len(mesh.vertices) < _FEWEST_VERTICES:
            raise SceneError(
                self._source,
                f"its mesh has {len(mesh.vertices)} vertices; a solid has at least four",
                element=shape.label,
            )
        return self._store(f"{stem}.msh", to_msh(mesh))

    def _store(self, name: str, data: bytes) -> str:
        key = _free(re.sub(r"[^\w.\-]", "_", name), self._files)
        self._files.add(key)
        self._assets[key] = data
        return key

    def _add(self, name: str, file: str, shape: Shape) -> mujoco.MjsMesh:
        mesh = self._spec.add_mesh(name=_free(name, self._names), file=file, scale=shape.scale)
        self._names.add(mesh.name)
        return mesh

    def _add_shell(self, stem: str, file: str, shape: Shape) -> str:
        """A mesh that is only drawn: it may be open or flat."""
        mesh = self._add(f"{stem}_visual", file, shape)
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        return str(mesh.name)


def _may_have_colors(path: Path) -> bool:
    suffix = path.suffix.lower()
    if suffix == ".obj":
        return path.is_file() and b"\nusemtl" in path.read_bytes()
    return suffix not in (".stl", ".msh")


def _as_mujoco_reads_it(path: Path) -> bytes | None:
    """The bytes for MuJoCo's own decoders; None where they would not do."""
    if path.suffix.lower() != ".stl":
        return path.read_bytes()
    count = stl_face_count(path)
    if count is None or count > _STL_MOST_FACES:
        return None
    return path.read_bytes()[: STL_HEADER + count * STL_FACE.itemsize]


def _has_no_volume(mesh: trimesh.Trimesh) -> bool:
    """Whether MuJoCo would refuse the mesh, which it weighs even where it need not."""
    solid = legacy(mesh)
    return solid is None or solid.mass < _LEAST_VOLUME


def _normal_if_flat(mesh: trimesh.Trimesh) -> Array | None:
    """Unit normal of the plane that all vertices lie in; None if there is none."""
    centred = mesh.vertices - mesh.vertices.mean(axis=0)
    scatter = centred.T @ centred
    spread, axes = np.linalg.eigh(scatter)
    if not spread[2] > 0 or spread[0] > (_FLAT * 100) ** 2 * spread[2]:
        return None  # clearly solid; the squares lose half of the digits, so look closer else
    depth = np.ptp(centred @ axes[:, 0])
    normal: Array = axes[:, 0]
    return normal if depth <= _FLAT * np.ptp(centred @ axes[:, 2]) else None


def _thick(mesh: trimesh.Trimesh, offset: Array) -> trimesh.Trimesh:
    """Two copies of a flat mesh, half an offset up and down."""
    up, down = mesh.copy(), mesh.copy()
    up.vertices = mesh.vertices + offset / 2
    down.vertices = mesh.vertices - offset / 2
    down.faces = mesh.faces[:, ::-1]
    return join([up, down])


def _at_least_four(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The same surface with four vertices or more: a lone triangle is split at its centre."""
    if len(mesh.vertices) >= _FEWEST_VERTICES or len(mesh.faces) == 0:
        return mesh
    a, b, c = mesh.faces[0]
    new = len(mesh.vertices)
    centre = mesh.vertices[[a, b, c]].mean(axis=0)
    faces = np.concatenate([[[a, b, new], [b, c, new], [c, a, new]], mesh.faces[1:]])
    return trimesh.Trimesh(np.vstack([mesh.vertices, centre]), faces, process=False)


def _free(name: str, taken: set[str]) -> str:
    """A name that is not taken: `name`, `name1`, `name2`; a suffix stays at the end."""
    stem, dot, suffix = name.rpartition(".") if "." in name else (name, "", "")
    candidate, number = name, 0
    while candidate in taken:
        number += 1
        candidate = f"{stem}{number}{dot}{suffix}"
    return candidate
