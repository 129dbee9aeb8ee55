"""What each format claims, against what the file holds."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from orbisim.errors import SceneError
from orbisim.scene.safety import meshformats
from orbisim.scene.safety.confine import confined_to
from orbisim.scene.safety.meshformats import (
    CHECKS,
    check_counts,
    check_faces,
    check_presence,
    check_vertices,
    is_lfs_pointer,
    stl_face_count,
)
from orbisim.scene.safety.problem import MeshProblemError

ASCII = b"solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"


def check(folder: Path, suffix: str, data: bytes) -> None:
    path = folder / f"m{suffix}"
    path.write_bytes(data)
    check_presence(path)
    CHECKS[suffix](path)


def stl(count: int, faces: int, header: bytes = b"") -> bytes:
    triangle = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)
    return header.ljust(80, b" ") + struct.pack("<I", count) + faces * triangle


def msh(nvert: int, nface: int, vertices: list[float], faces: list[int]) -> bytes:
    head = struct.pack("<4i", nvert, 0, 0, nface)
    return head + np.array(vertices, "<f4").tobytes() + np.array(faces, "<i4").tobytes()


TRIANGLE = [0.0, 0, 0, 1, 0, 0, 0, 1, 0]


def glb(document: object, padding: int = 0) -> bytes:
    text = json.dumps(document).encode()
    return b"glTF" + struct.pack("<IIII", 2, 0, len(text) + padding, 0x4E4F534A) + text


@pytest.mark.parametrize(
    ("suffix", "data"),
    [
        (".stl", stl(2, 2)),
        (".stl", stl(2, 2, b"solid, but binary")),
        (".stl", stl(1, 1) + b"more"),
        (".stl", ASCII),
        (".obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        (".msh", msh(3, 1, TRIANGLE, [0, 1, 2])),
        (".msh", msh(3, 0, TRIANGLE, [])),
        (".msh", b"$MeshFormat\n4.1 0 8\n"),
        (".ply", b"ply\nelement vertex 3\nelement face 1\nend_header\n0 0 0 1 0 0 0 1 0"),
        (".off", b"# a comment\nOFF 3 1 0\n0 0 0 1 0 0 0 1 0 3 0 1 2 # end\n"),
        (".glb", glb({"accessors": [{"count": 3}]})),
    ],
)
def test_what_is_in_order(tmp_path: Path, suffix: str, data: bytes) -> None:
    check(tmp_path, suffix, data)


@pytest.mark.parametrize(
    ("suffix", "data", "message"),
    [
        (".stl", stl(3, 2), "claims 3 triangles in its header and holds 2"),
        (".stl", b"short", "is no STL: 5 bytes"),
        (".stl", stl(0, 0), "is empty"),
        (".stl", stl(1, 1)[:-6] + b"\0\0\xc0\x7f\0\0", "triangle 0 is not finite"),
        (".stl", ASCII + b"vertex 0 0 0\n", "4 vertices, which is not three"),
        (".stl", ASCII.replace(b"1 0 0", b"1 0 x"), "a coordinate that is no number"),
        (".stl", ASCII.replace(b"1 0 0", b"1 0 1e39"), "vertex 1 is not finite"),
        (".msh", b"short", "is no MSH"),
        (".msh", msh(-1, 0, [], []), "a negative count"),
        (".msh", msh(3, 2, TRIANGLE, [0, 1, 2]), "and 2 faces, 76 bytes, and has 64"),
        (".msh", msh(3, 1, TRIANGLE, [0, 1, 3]), r"face 0 names a vertex.*\(0 to 2 do\)"),
        (".msh", msh(3, 1, [*TRIANGLE[:-1], np.inf], [0, 1, 2]), "vertex 2 is not finite"),
        (".ply", b"ply\nelement vertex 3\n", "its header is incomplete"),
        (".ply", b"ply\nelement vertex 900\nelement face 1\nend_header\n", "more than it holds"),
        (".off", b"FOO 3 1 0", "does not start with OFF"),
        (".off", b"OFF 900 1 0\n0 0 0", "more than it holds"),
        (".glb", b"glTF", "does not start with 'glTF'"),
        (".glb", glb({}, padding=1), "not complete JSON"),
        (".glb", glb({"accessors": [{}]}), "its JSON is broken"),
        (".glb", glb([1]), "its JSON is broken"),
        (".glb", glb({"accessors": [{"count": 10**9}]}), "claims 1000000000 elements"),
        (".obj", b"", "is empty"),
    ],
)
def test_what_is_refused(tmp_path: Path, suffix: str, data: bytes, message: str) -> None:
    with pytest.raises(MeshProblemError, match=message):
        check(tmp_path, suffix, data)


def test_a_header_does_not_decide_whether_a_file_is_text(tmp_path: Path) -> None:
    path = tmp_path / "m.stl"
    for data, count in ((stl(2, 2, b"solid"), 2), (ASCII, None)):
        path.write_bytes(data)
        assert stl_face_count(path) == count


def test_the_first_wrong_triangle_is_named_across_chunks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(meshformats, "_CHUNK", 2)
    data = bytearray(stl(5, 5))
    data[84 + 3 * 50 + 12 : 84 + 3 * 50 + 16] = struct.pack("<f", np.nan)
    with pytest.raises(MeshProblemError, match="triangle 3 is not finite"):
        check(tmp_path, ".stl", bytes(data))


def test_presence(tmp_path: Path) -> None:
    with pytest.raises(MeshProblemError, match="does not exist"):
        check_presence(tmp_path / "gone.obj")
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(MeshProblemError, match="is not a file"):
        check_presence(tmp_path / "folder.obj")
    (tmp_path / "m.fbx").write_text("x")
    with pytest.raises(MeshProblemError, match=r"the suffix '.fbx'; expected one of .stl"):
        check_presence(tmp_path / "m.fbx")


def test_too_much_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(meshformats, "MAX_BYTES", 3)
    (tmp_path / "m.obj").write_bytes(b"four")
    with pytest.raises(MeshProblemError, match="has 4 bytes; at most 3"):
        check_presence(tmp_path / "m.obj")
    check_counts(vertices=meshformats.MAX_FACES, faces=meshformats.MAX_FACES)
    with pytest.raises(MeshProblemError, match="at most 50000000 faces"):
        check_counts(vertices=9, faces=meshformats.MAX_FACES + 1)


def test_a_pointer_is_told_from_a_mesh(tmp_path: Path) -> None:
    pointer, mesh = tmp_path / "m.stl", tmp_path / "n.stl"
    pointer.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
    mesh.write_bytes(stl(1, 1))
    assert is_lfs_pointer(pointer)
    assert not is_lfs_pointer(mesh)
    with pytest.raises(MeshProblemError, match="Git LFS pointer") as caught:
        check_presence(pointer)
    assert caught.value.remedy is not None
    assert "git lfs pull" in caught.value.remedy


@pytest.mark.parametrize(
    ("library", "image"),
    [("../out.mtl", "a.png"), ("in.mtl", "/etc/passwd"), ("in.mtl", "-s 1 ../x")],
)
def test_materials_stay_in_the_archive(tmp_path: Path, library: str, image: str) -> None:
    root = tmp_path / "root"
    root.mkdir()
    (root / "in.mtl").write_text(f"newmtl m\nmap_Kd {image}\n")
    mesh = f"mtllib {library}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".encode()
    check(root, ".obj", mesh)
    with confined_to(root), pytest.raises(SceneError, match=r"outside the archive|absolute path"):
        check(root, ".obj", mesh)


def test_bounds_of_vertices_and_faces() -> None:
    most = float(np.finfo(np.float32).max)
    check_vertices(np.full((2, 3), most))
    with pytest.raises(MeshProblemError, match="vertex 1"):
        check_vertices(np.array([[0, 0, 0], [0, -most * 1.001, 0]]))
    check_faces(np.array([[0, 1, 2]]), 3)
    for face in ([-1, 1, 2], [0, 1, 3]):
        with pytest.raises(MeshProblemError, match="face 1"):
            check_faces(np.array([[0, 1, 2], face]), 3)
