"""OBJ files, looked at without a loop over their lines."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbisim import load_scene
from orbisim.errors import SceneError
from orbisim.scene.safety import objfile
from orbisim.scene.safety.objfile import obj_contents, obj_vertices
from orbisim.scene.safety.problem import MeshProblemError

CUBE = b"""# a cube
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
v 1 0 1
v 1 1 1
v 0 1 1
f 1 3 2
f 1 4 3
f 5 6 7
f 5 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
"""


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d,
        lambda d: d.replace(b"\n", b"\r\n"),
        lambda d: d.replace(b"v ", b"  v\t").replace(b"f ", b"\tf  "),
        lambda d: d.replace(b"v 1 0 0", b"v 1 0 0 # corner"),
        lambda d: d.replace(b"v 1 0 0\n", b"v 1 0 0 0.5 0.5 0.5\n"),
        lambda d: d.replace(b"v 1 0 0\n", b"v 1.0e0 -0 +0.\n"),
        lambda d: d.replace(b"f 1 3 2", b"f 1/1/1 3//2 2/3"),
        lambda d: d.replace(b"f 1 3 2", b"f -8 -6 -7"),
        lambda d: d.rstrip(b"\n"),
        lambda d: b"vn 0 0 1\nvt nonsense\nvp\n" + d,
    ],
)
def test_spellings(change) -> None:
    found = obj_contents(change(CUBE))
    assert (found.vertices, found.faces, found.several_objects) == (8, 8, False)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (CUBE.replace(b"v 1 0 0", b"v 1 nan 0"), "vertex 1 is not finite"),
        (CUBE.replace(b"v 1 1 1", b"v 1 1e39 1"), "vertex 6 is not finite"),
        (CUBE.replace(b"v 1 0 0", b"v 1 0"), r"vertex 1 is '1 0'; expected three numbers"),
        (CUBE.replace(b"v 1 0 0", b"v one 0 0"), r"vertex 1 is 'one 0 0'; expected three"),
        (CUBE.replace(b"v 1 0 0", b"v 0x1 0 0"), "expected three numbers"),
        (CUBE + b"f 1 2 9\n", "a face with vertex 9; it has vertices 1 to 8"),
        (CUBE + b"f 1 2 -9\n", "a face with vertex -9"),
        (CUBE + b"f 1 2 0\n", "a face with vertex 0"),
        (CUBE + b"f 1 2 99999999999999999999\n", "a face with vertex|not a list of vertex"),
        (CUBE + b"f 1 2 a\n", "not a list of vertex numbers"),
        (CUBE + b"f 1 2 1.5\n", "not a list of vertex numbers"),
        (CUBE + b"\0", "NUL bytes"),
    ],
)
def test_what_is_refused(data: bytes, message: str) -> None:
    with pytest.raises(MeshProblemError, match=message):
        obj_contents(data)


def test_objects_after_the_first_face() -> None:
    assert not obj_contents(b"o one\ng all\n" + CUBE).several_objects
    assert obj_contents(CUBE + b"o two\nv 0 0 0\n").several_objects
    assert obj_contents(CUBE + b"g\n").several_objects
    assert not obj_contents(CUBE + b"off 1\ngroup\n").several_objects


def test_pieces_give_what_the_whole_gives(monkeypatch: pytest.MonkeyPatch) -> None:
    data = CUBE + b"o two\n" + CUBE.replace(b"v 1 0 0", b"v 7 0 0 # far")
    whole, points = obj_contents(data), obj_vertices(data)
    monkeypatch.setattr(objfile, "_CHUNK", 16)
    assert obj_contents(data) == whole
    np.testing.assert_array_equal(obj_vertices(data), points)
    with pytest.raises(MeshProblemError, match="vertex 17 is 'x'"):
        obj_contents(data + b"v 0 0 0\nv x\n")


numbers = st.floats(-1e30, 1e30).map(lambda x: f"{x!r}".encode())
lines = st.one_of(
    st.tuples(st.just(b"v"), numbers, numbers, numbers).map(b" ".join),
    st.binary(max_size=20).map(lambda b: b.replace(b"\0", b"")),
    st.sampled_from([b"f 1 1 1", b"o a", b"", b"# v 1", b"vn 0 0 1"]),
)


@given(st.lists(lines, max_size=30))
def test_any_lines_are_counted_or_refused(found: list[bytes]) -> None:
    """Against a loop over lines."""
    data = b"\n".join(found)
    try:
        contents = obj_contents(data)
    except MeshProblemError:
        return
    blank = [line.lstrip(b" \t") for line in data.replace(b"\r", b"\n").split(b"\n")]
    assert contents.vertices == sum(line[:2] in (b"v ", b"v\t") for line in blank)
    assert contents.faces == sum(line[:2] in (b"f ", b"f\t") for line in blank)


def test_a_file_without_faces_is_its_hull(tmp_path: Path) -> None:
    """As MuJoCo takes it."""
    corners = b"".join(line + b"\n" for line in CUBE.splitlines() if line.startswith(b"v"))
    (tmp_path / "corners.obj").write_bytes(corners)
    path = tmp_path / "scene.xml"
    path.write_text("""
        <mujoco><asset><mesh name="m" file="corners.obj"/></asset><worldbody><body><freejoint/>
        <geom type="mesh" mesh="m"/></body></worldbody></mujoco>""")
    scene = load_scene(path)
    plain = mujoco.MjModel.from_xml_path(str(path))
    assert scene.model.body_mass[1] == plain.body_mass[1] == pytest.approx(1000.0)
    urdf = tmp_path / "robot.urdf"
    urdf.write_text("""
        <robot name="r"><link name="l">
        <collision><geometry><mesh filename="corners.obj"/></geometry></collision>
        <visual><geometry><mesh filename="corners.obj"/></geometry></visual></link></robot>""")
    assert load_scene(urdf).model.ngeom == 2
    (tmp_path / "corners.obj").write_bytes(b"# nothing\n")
    with pytest.raises(SceneError, match="is empty: 0 vertices"):
        load_scene(path)


def test_pointers_of_git_lfs(tmp_path: Path) -> None:
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12345\n"
    (tmp_path / "arm.stl").write_text(pointer)
    path = tmp_path / "scene.xml"
    path.write_text("""
        <mujoco><asset><mesh name="m" file="arm.stl"/></asset><worldbody><body><freejoint/>
        <geom type="mesh" mesh="m"/></body></worldbody></mujoco>""")
    with pytest.raises(SceneError, match=r"Git LFS pointer.*; run git lfs pull"):
        load_scene(path)
