"""What each mesh format claims, checked against what the file holds.

One function for each suffix, in `CHECKS`; each raises `MeshProblemError`, which says what is wrong
and leaves it to the caller to say which file and who referred to it. STL, OBJ and MuJoCo's MSH are
checked to the last vertex; of the others only the header is: `check_vertices` and `check_faces` do
the rest once they are loaded.
"""

from __future__ import annotations

import dataclasses
import json
import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.scene.safety.confine import confinement, resolve_inside
from orbisim.scene.safety.objfile import obj_contents
from orbisim.scene.safety.problem import MeshProblemError


@dataclasses.dataclass(frozen=True)
class Findings:
    """What a check found beside that the file is in order.

    Attributes:
      several_objects: an OBJ file holds several objects, of which MuJoCo reads the first.
    """

    several_objects: bool = False


MAX_FACES = 50_000_000
"""More faces than this are refused."""

MAX_BYTES = 4 * 2**30
"""Larger mesh files are refused."""

_POINTER, _MOST_POINTER = b"version https://git-lfs.github.com/spec/", 1024
"""How the small file begins that stands for a large one until Git LFS has fetched it."""

_MAX_FLOAT32 = float(np.finfo(np.float32).max)


def check_presence(path: Path) -> None:
    """Refuses what is no regular, non-empty file of a known suffix."""
    if not path.exists():
        raise MeshProblemError("does not exist")
    if not path.is_file():
        raise MeshProblemError("is not a file")
    if path.suffix.lower() not in CHECKS:
        raise MeshProblemError(
            f"has the suffix {path.suffix or 'none'!r}; expected one of {', '.join(CHECKS)}"
        )
    size = path.stat().st_size
    if size == 0:
        raise MeshProblemError("is empty")
    if is_lfs_pointer(path):
        raise MeshProblemError(
            "is a Git LFS pointer, not the mesh itself", "run git lfs pull in its repository"
        )
    if size > MAX_BYTES:
        raise MeshProblemError(f"has {size} bytes; at most {MAX_BYTES} are read")


def is_lfs_pointer(path: Path) -> bool:
    """Whether a file only says which file Git LFS is to put in its place."""
    return (
        path.is_file()
        and path.stat().st_size < _MOST_POINTER
        and path.read_bytes().startswith(_POINTER)
    )


# ---- STL ---------------------------------------------------------------------------------------

STL_HEADER = 84
"""Bytes before the faces of a binary STL: 80 of comment, 4 of their number."""
STL_FACE = np.dtype([("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("attribute", "<u2")])
_CHUNK = 1_000_000
"""Faces that are checked at a time: 50 MB of them."""


def stl_face_count(path: Path) -> int | None:
    """Number of faces of a binary STL file; None for an ASCII one.

    Raises:
      MeshProblemError: the header claims more faces than the file holds.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(STL_HEADER)
    if len(header) == STL_HEADER:
        count = int(struct.unpack("<I", header[80:])[0])
        if size == STL_HEADER + count * STL_FACE.itemsize:
            return count
    if header.lstrip().lower().startswith(b"solid"):
        return None
    if len(header) < STL_HEADER:
        raise MeshProblemError(f"is no STL: {size} bytes are less than its header has")
    if size < STL_HEADER + count * STL_FACE.itemsize:
        holds = (size - STL_HEADER) // STL_FACE.itemsize
        raise MeshProblemError(f"claims {count} triangles in its header and holds {holds}")
    return count


def _check_stl(path: Path) -> Findings:
    count = stl_face_count(path)
    if count is None:
        _check_ascii_stl(path)
        return Findings()
    check_counts(vertices=3 * count, faces=count)
    faces = np.memmap(path, STL_FACE, mode="r", offset=STL_HEADER, shape=(count,))
    for start in range(0, count, _CHUNK):
        finite = np.isfinite(faces["vertices"][start : start + _CHUNK]).all(axis=(1, 2))
        if not finite.all():
            raise MeshProblemError(f"triangle {start + int(np.argmin(finite))} is not finite")
    return Findings()


_ASCII_VERTEX = re.compile(rb"\bvertex[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", re.IGNORECASE)


def _check_ascii_stl(path: Path) -> None:
    rows = _ASCII_VERTEX.findall(path.read_bytes())
    check_counts(vertices=len(rows), faces=len(rows) // 3)
    if len(rows) % 3:
        raise MeshProblemError(f"has {len(rows)} vertices, which is not three for each triangle")
    check_vertices(_numbers(rows))


def _numbers(rows: Sequence[Sequence[bytes]]) -> npt.NDArray[np.float64]:
    try:
        return np.array(rows).astype(np.float64)
    except ValueError as error:
        raise MeshProblemError(f"has a coordinate that is no number: {error}") from None


# ---- OBJ ---------------------------------------------------------------------------------------

_OBJ_LIBRARY = re.compile(rb"^[ \t]*mtllib[ \t]+([^\r\n]*)", re.MULTILINE)
_MTL_IMAGE = re.compile(
    rb"^[ \t]*(?:map_\w+|bump|disp|decal|refl|norm)[ \t]+([^\r\n]*)", re.M | re.I
)


def _check_obj(path: Path) -> Findings:
    data = path.read_bytes()
    found = obj_contents(data)
    # without faces MuJoCo takes the hull of the vertices
    check_counts(vertices=found.vertices, faces=found.faces or found.vertices // 3)
    _check_obj_references(path, data)
    return Findings(found.several_objects)


def _check_obj_references(path: Path, data: bytes) -> None:
    """Refuses a material library, or an image it names, outside the archive."""
    if confinement() is None:
        return
    for name in _names(_OBJ_LIBRARY, data):
        library = resolve_inside(name, path.parent, source=str(path), element="mtllib")
        if library.is_file():
            for image in _names(_MTL_IMAGE, library.read_bytes()):
                file = image.split()[-1] if image.startswith("-") else image
                resolve_inside(file, library.parent, source=str(library), element="texture map")


def _names(pattern: re.Pattern[bytes], data: bytes) -> Iterator[str]:
    return (found.decode(errors="replace").strip() for found in pattern.findall(data))


# ---- MuJoCo's MSH ------------------------------------------------------------------------------

_MSH_HEADER = 16
"""Bytes before the data of MuJoCo's binary mesh format: four counts of 4."""


def _check_msh(path: Path) -> Findings:
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(_MSH_HEADER)
    if header.startswith(b"$MeshFormat"):
        return Findings()  # Gmsh, which MuJoCo's own reader checks
    if len(header) < _MSH_HEADER:
        raise MeshProblemError(f"is no MSH: {size} bytes are less than its header has")
    nvert, nnormal, ntexcoord, nface = struct.unpack("<4i", header)
    if min(nvert, nnormal, ntexcoord, nface) < 0:
        raise MeshProblemError("has a negative count in its header")
    check_counts(vertices=nvert, faces=nface or nvert // 3)
    expected = _MSH_HEADER + 12 * nvert + 12 * nnormal + 8 * ntexcoord + 12 * nface
    if size != expected:
        raise MeshProblemError(
            f"claims {nvert} vertices, {nnormal} normals, {ntexcoord} texture coordinates and "
            f"{nface} faces, {expected} bytes, and has {size}"
        )
    check_vertices(np.memmap(path, "<f4", "r", _MSH_HEADER, (nvert, 3)))
    if nface:
        start = _MSH_HEADER + 12 * (nvert + nnormal) + 8 * ntexcoord
        check_faces(np.memmap(path, "<i4", "r", start, (nface, 3)), nvert)
    return Findings()


# ---- formats that trimesh reads ----------------------------------------------------------------


def _check_ply(path: Path) -> Findings:
    with path.open("rb") as file:
        head = file.read(65536)
    end = head.find(b"end_header")
    if not head.startswith(b"ply") or end < 0:
        raise MeshProblemError("is no PLY: its header is incomplete")
    claimed = {
        name: int(count)
        for name, count in re.findall(rb"element[ \t]+(\w+)[ \t]+(\d+)", head[:end])
    }
    vertices, faces = claimed.get(b"vertex", 0), claimed.get(b"face", 0)
    check_counts(vertices=vertices, faces=faces)
    if sum(claimed.values()) > path.stat().st_size:  # each takes more than one byte
        raise MeshProblemError(f"claims {vertices} vertices and {faces} faces, more than it holds")
    return Findings()


def _check_off(path: Path) -> Findings:
    text = re.sub(rb"#[^\n]*", b"", path.read_bytes())
    found = re.match(rb"\s*(?:ST)?C?N?4?n?OFF\s+(\d+)\s+(\d+)", text)
    if not found:
        raise MeshProblemError("is no OFF: it does not start with OFF and two counts")
    vertices, faces = int(found[1]), int(found[2])
    check_counts(vertices=vertices, faces=faces)
    if 6 * vertices + 8 * faces > len(text):  # three or four numbers, each with a separator
        raise MeshProblemError(f"claims {vertices} vertices and {faces} faces, more than it holds")
    return Findings()


def _check_glb(path: Path) -> Findings:
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(20)
        if len(header) < 20 or header[:4] != b"glTF":
            raise MeshProblemError("is no GLB: it does not start with 'glTF'")
        length, kind = struct.unpack("<II", header[12:])
        if kind != 0x4E4F534A or length > size - 20:
            raise MeshProblemError("is no GLB: its first chunk is not complete JSON")
        text = file.read(length)
    try:
        document = json.loads(text)
        counts = [int(accessor["count"]) for accessor in document.get("accessors", ())]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise MeshProblemError("is no GLB: its JSON is broken") from None
    if any(count < 0 or count > size for count in counts):
        raise MeshProblemError(f"claims {max(counts)} elements in {size} bytes")
    return Findings()


def _checked_when_loaded(path: Path) -> Findings:
    """COLLADA: `orbisim.scene.safety.collada` finds what is wrong while it reads."""
    return Findings()


CHECKS: Mapping[str, Callable[[Path], Findings]] = {
    ".stl": _check_stl,
    ".obj": _check_obj,
    ".msh": _check_msh,
    ".dae": _checked_when_loaded,
    ".ply": _check_ply,
    ".glb": _check_glb,
    ".off": _check_off,
}

CHECKED_WHOLE = (".stl", ".obj", ".msh")
"""Formats whose check leaves nothing to find once they are loaded."""


def check_counts(*, vertices: int, faces: int) -> None:
    """Refuses a mesh with nothing in it, or too much."""
    if vertices == 0 or faces == 0:
        raise MeshProblemError(f"is empty: {vertices} vertices, {faces} faces")
    if faces > MAX_FACES or vertices > 3 * MAX_FACES:
        raise MeshProblemError(
            f"has {vertices} vertices and {faces} faces; at most {MAX_FACES} faces are read"
        )


def check_vertices(vertices: npt.NDArray[Any]) -> None:
    """Refuses [n, 3] vertices that do not fit single precision, as MuJoCo stores them."""
    finite = (np.abs(vertices) <= _MAX_FLOAT32).all(axis=1)
    if not finite.all():
        raise MeshProblemError(f"vertex {int(np.argmin(finite))} is not finite")


def check_faces(faces: npt.NDArray[Any], nvertex: int) -> None:
    """Refuses [n, 3] faces that name vertices which do not exist."""
    bad = ((faces < 0) | (faces >= nvertex)).any(axis=1)
    if bad.any():
        raise MeshProblemError(
            f"face {int(np.argmax(bad))} names a vertex that does not exist (0 to {nvertex - 1} do)"
        )
