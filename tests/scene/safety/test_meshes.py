"""Mesh files: what is refused, and that what is loaded is whole."""

from __future__ import annotations

import struct
from pathlib import Path

import hypothesis
import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from orbisim import load_scene
from orbisim.errors import SceneError
from orbisim.scene.safety.meshes import check_mesh_file, load_mesh, load_mesh_file, scaled, to_msh
from tests.clock import Stopwatch

DATA = Path(__file__).parents[1] / "urdf" / "data"
BOX = trimesh.creation.box((1, 2, 3))
FORMATS = ("stl", "obj", "ply", "off", "glb", "dae", "msh")


def write(folder: Path, suffix: str, mesh: trimesh.Trimesh = BOX) -> Path:
    file = folder / f"part.{suffix}"
    data = to_msh(mesh) if suffix == "msh" else mesh.export(file_type=suffix)
    file.write_bytes(data if isinstance(data, bytes) else data.encode())
    return file


@pytest.mark.parametrize("suffix", FORMATS)
def test_every_format_loads_as_it_is(tmp_path: Path, suffix: str) -> None:
    file = write(tmp_path, suffix)
    check_mesh_file(file)
    mesh = load_mesh(file)
    assert mesh.volume == pytest.approx(6.0, rel=1e-6)
    np.testing.assert_allclose(mesh.extents, [1, 2, 3], rtol=1e-6)


def test_suffix_in_capitals(tmp_path: Path) -> None:
    check_mesh_file(write(tmp_path, "stl").rename(tmp_path / "PART.STL"))


@pytest.mark.parametrize("scale", [2.0, (1, 2, 3), (-1, 1, 1), (-1, -1, -1)])
def test_scale_keeps_normals_outward(tmp_path: Path, scale) -> None:
    mesh = load_mesh(write(tmp_path, "obj"), scale)
    factors = np.broadcast_to(scale, 3)
    assert mesh.volume == pytest.approx(6 * np.abs(np.prod(factors)))
    np.testing.assert_allclose(mesh.extents, [1, 2, 3] * np.abs(factors))


def test_collada_nodes_keep_their_places() -> None:
    loaded = load_mesh_file(DATA / "two_nodes.dae")
    assert [part.rgba for part in loaded.parts] == [(1, 0, 0, 1), (0, 0, 1, 1)]
    whole = loaded.joined()
    np.testing.assert_allclose(whole.bounds, [[0, 0, 1], [0.5, 0.2, 1.1]], atol=1e-7)
    assert whole.volume == pytest.approx(0.001 + 0.002)


def test_broken_materials_do_not_cost_geometry(tmp_path: Path) -> None:
    text = (DATA / "two_nodes.dae").read_text()
    text = text.replace('url="#blue-effect"', 'url="#gone"')
    text = text.replace("<color>1 0 0 1</color>", '<texture texture="gone" texcoord="UV"/>')
    file = tmp_path / "part.dae"
    file.write_text(text)
    loaded = load_mesh_file(file)
    assert loaded.joined().volume == pytest.approx(0.003)
    assert loaded.textured


def test_up_axis_is_ignored_and_noted(tmp_path: Path) -> None:
    file = tmp_path / "part.dae"
    file.write_text((DATA / "two_nodes.dae").read_text().replace("Z_UP", "Y_UP"))
    loaded = load_mesh_file(file)
    np.testing.assert_allclose(loaded.joined().bounds[1], [0.5, 0.2, 1.1])
    assert "Y_UP" in loaded.notes[0]


@hypothesis.given(
    vertices=hnp.arrays(np.float32, (5, 3), elements=st.floats(-10, 10, width=32)),
    faces=hnp.arrays(np.int64, (6, 3), elements=st.integers(0, 4)),
)
def test_msh_round_trip(vertices, faces, tmp_path_factory) -> None:
    file = tmp_path_factory.mktemp("m") / "m.msh"
    file.write_bytes(to_msh(trimesh.Trimesh(vertices, faces, process=False)))
    check_mesh_file(file)
    mesh = load_mesh(file)
    np.testing.assert_array_equal(mesh.vertices, vertices)
    np.testing.assert_array_equal(mesh.faces, faces)


def test_msh_is_what_mujoco_reads() -> None:
    spec = mujoco.MjSpec()
    spec.assets = {"m.msh": to_msh(BOX)}
    spec.add_mesh(name="m", file="m.msh")
    body = spec.worldbody.add_body()
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="m")
    assert spec.compile().body_mass[1] == pytest.approx(6000)


# ---- what is refused ---------------------------------------------------------------------------


def _stl(claims: int | None = None, spoil: float | None = None) -> bytes:
    data = bytearray(BOX.export(file_type="stl"))
    if claims is not None:
        data[80:84] = struct.pack("<I", claims)
    if spoil is not None:
        data[96 + 50 * 3 : 100 + 50 * 3] = struct.pack("<f", spoil)
    return bytes(data)


def _msh(*counts: int, spoil: bool = False, face: int | None = None) -> bytes:
    data = bytearray(to_msh(BOX))
    if counts:
        data[:16] = struct.pack("<4i", *counts)
    if spoil:
        data[16:20] = struct.pack("<f", np.nan)
    if face is not None:
        data[-4:] = struct.pack("<i", face)
    return bytes(data)


OBJ = BOX.export(file_type="obj")
PLY = BOX.export(file_type="ply")
OFF = BOX.export(file_type="off")
GLB = BOX.export(file_type="glb")
DAE = (DATA / "two_nodes.dae").read_text()
ASCII = BOX.export(file_type="stl_ascii")
BROKEN = {
    "empty.stl": (b"", "is empty"),
    "short.stl": (b"\0" * 50, "less than its header"),
    "billion.stl": (_stl(claims=10**9), "claims 1000000000 triangles in its header and holds 12"),
    "none.stl": (_stl(claims=0)[:84], "0 vertices, 0 faces"),
    "nan.stl": (_stl(spoil=np.nan), "triangle 3 is not finite"),
    "inf.stl": (_stl(spoil=-np.inf), "triangle 3 is not finite"),
    "ascii_nan.stl": (ASCII.replace("vertex -0.5", "vertex nan", 1), "vertex 0 is not finite"),
    "ascii_text.stl": (ASCII.replace("vertex -0.5", "vertex x", 1), "no number"),
    "ascii_odd.stl": (ASCII.replace("vertex", "vortex", 1), "not three for each"),
    "ascii_empty.stl": ("solid nothing\nendsolid\n", "0 vertices, 0 faces"),
    "nan.obj": (OBJ.replace("v -0.50000000", "v nan", 1), "is not finite"),
    "inf.obj": (OBJ.replace("v -0.50000000", "v -inf", 1), "is not finite"),
    "huge.obj": (OBJ.replace("v -0.50000000", "v 1e999", 1), "is not finite"),
    "large.obj": (OBJ.replace("v -0.50000000", "v 1e39", 1), "is not finite"),
    "digits.obj": (OBJ.replace("v -0.50000000", "v " + "9" * 60, 1), "is not finite"),
    "text.obj": (OBJ.replace("v -0.50000000", "v x", 1), "expected three numbers"),
    "two.obj": ("v 1 2\nv 1 2\nv 3 4\nf 1 2 3\n", "expected three numbers"),
    "range.obj": (OBJ + "f 1 2 99\n", "vertex 99; it has vertices 1 to"),
    "zero.obj": (OBJ + "f 0 1 2\n", "vertex 0"),
    "negative.obj": (OBJ + "f -1 -2 -99\n", "vertex -99"),
    "face.obj": (OBJ + "f a b c\n", "not a list of vertex numbers"),
    "points.obj": ("v 0 0 0\nv 1 0 0\n", "2 vertices, 0 faces"),
    "binary.obj": (b"v 1 2 3\n\0\0", "NUL"),
    "counts.msh": (_msh(10**7, 0, 0, 12), "claims 10000000 vertices"),
    "billion.msh": (_msh(10**9, 0, 0, 10**9), "has 1000000000 vertices .* at most"),
    "size.msh": (_msh(9, 0, 0, 12), "claims 9 vertices"),
    "negative.msh": (_msh(-1, 0, 0, 12), "negative count"),
    "nan.msh": (_msh(spoil=True), "vertex 0 is not finite"),
    "range.msh": (_msh(face=8), "face 11 names a vertex that does not exist"),
    "short.msh": (b"\1\0\0", "less than its header"),
    "claims.ply": (PLY.replace(b"element vertex 8", b"element vertex 80000"), "claims 80000"),
    "billion.ply": (PLY.replace(b"face 12", b"face 1000000000"), "1000000000 faces; at most"),
    "header.ply": (b"ply\nformat ascii 1.0\n", "header is incomplete"),
    "cut.ply": (PLY[:-20], "cannot be read"),
    "claims.off": (OFF.replace("8 12", "8 1000000", 1), "claims 8 vertices and 1000000 faces"),
    "range.off": (OFF.replace("3 1 3 0", "3 1 3 99", 1), "face"),
    "text.off": ("hello", "is no OFF"),
    "text.glb": (b"hello, this is not a glb", "is no GLB"),
    "json.glb": (GLB.replace(b'{"', b"{{", 1), "JSON is broken"),
    "count.glb": (GLB.replace(b'"count":36', b'"count":99'), "cannot be read|claims"),
    "nan.dae": (DAE.replace("0 0 0  10", "NaN 0 0  10", 1), "is not finite"),
    "text.dae": (DAE.replace("0 0 0  10", "0,0 0  10", 1), "'0,0', which is not finite"),
    "root.dae": ("<robot/>", "its root element is <robot>"),
    "bomb.dae": ('<!DOCTYPE a [<!ENTITY b "c">]><COLLADA>&b;</COLLADA>', "entities"),
    "unit.dae": (DAE.replace('meter="0.01"', 'meter="0"'), "meter='0'"),
    "nothing.dae": (DAE.replace("instance_geometry", "instance_nothing"), "is empty"),
    "none.dae": ("hello", "is no COLLADA"),
    "other.step": (b"ISO-10303-21", "suffix '.step'; expected one of .stl, .obj"),
    "none": (b"x", "suffix 'none'"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_are_refused(tmp_path: Path, name: str) -> None:
    content, says = BROKEN[name]
    file = tmp_path / name
    file.write_bytes(content.encode() if isinstance(content, str) else content)
    watch = Stopwatch()
    with pytest.raises(SceneError, match=says) as caught:
        check_mesh_file(file, source="robot.urdf", element="link 'a'")
    assert watch.seconds < 1
    message = str(caught.value)
    assert message.startswith(f"robot.urdf: link 'a': mesh file {str(file)!r} ")
    assert "\n" not in message


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"gone\.stl: does not exist"):
        check_mesh_file(tmp_path / "gone.stl")
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(SceneError, match=r"folder\.stl: is not a file"):
        check_mesh_file(tmp_path / "folder.stl")


def test_bytes_after_the_last_triangle_are_let_pass(tmp_path: Path) -> None:
    file = tmp_path / "part.stl"
    file.write_bytes(_stl() + b"trailer")
    check_mesh_file(file)
    text = f"""<robot name='r'><link name='a'><collision><geometry><mesh filename='{file}'/>
    </geometry></collision></link></robot>"""
    assert load_scene(text).model.nmesh == 1


def test_relative_indices_and_comments_in_obj(tmp_path: Path) -> None:
    file = tmp_path / "part.obj"
    file.write_text(
        "v 0 0 0 # first\nv 1 0 0\nv 0 1 0\nv 0 0 1e-3\nf -4 -2 -3\nf 1/1/1 2/2/2 4//1\n"
    )
    check_mesh_file(file)


def test_large_files_are_checked_in_a_moment(tmp_path: Path) -> None:
    sphere = trimesh.creation.icosphere(7)  # 327,680 faces
    for suffix, bound in (("stl", 0.5), ("msh", 0.5), ("obj", 5.0)):
        file = write(tmp_path, suffix, sphere)
        watch = Stopwatch()
        check_mesh_file(file)
        assert watch.seconds < bound


def test_mirrored_copy_of_an_open_mesh_turns_its_faces() -> None:
    triangle = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    np.testing.assert_array_equal(scaled(triangle, (-1, 1, 1)).faces, [[2, 1, 0]])


@pytest.mark.parametrize("name", ["billion.stl", "nan.obj", "range.msh"])
def test_mjcf_meshes_are_checked_before_mujoco_sees_them(tmp_path: Path, name: str) -> None:
    content, says = BROKEN[name]
    (tmp_path / "assets").mkdir()
    file = tmp_path / "assets" / name
    file.write_bytes(content.encode() if isinstance(content, str) else content)
    scene = tmp_path / "scene.xml"
    scene.write_text(
        f"""<mujoco><compiler meshdir="assets"/><asset><mesh name="m" file="{name}"/></asset>
        <worldbody><body><freejoint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""
    )
    with pytest.raises(SceneError, match=f"mesh 'm': mesh file .*{says}"):
        load_scene(scene)
