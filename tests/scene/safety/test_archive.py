"""Scenes in zip archives."""

from __future__ import annotations

import io
import os
import stat
import tempfile
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path

import hypothesis
import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import strategies as st

from orbisim import load_scene
from orbisim.errors import OutputError, SceneError
from orbisim.scene.readers import suffixes
from orbisim.scene.safety import archive
from orbisim.scene.safety.confine import confined_to, confinement, resolve_inside
from tests.clock import Stopwatch
from tests.disks import FULL_DISK, disk

BOX = trimesh.creation.box((1, 1, 1)).export(file_type="stl")
LONG = trimesh.creation.box((2, 1, 1)).export(file_type="stl")
EMPTY = "<mujoco/>"
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def mjcf(file: str, extra: str = "") -> str:
    return f"""<mujoco>{extra}<asset><mesh name="m" file="{file}"/></asset>
    <worldbody><body name="b"><freejoint/><geom type="mesh" mesh="m"/></body></worldbody>
    </mujoco>"""


def urdf(file: str) -> str:
    return f"""<robot name="r"><link name="a"/><link name="b"><collision><geometry>
    <mesh filename="{file}"/></geometry></collision></link>
    <joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint></robot>"""


def zipped(folder: Path, entries: Mapping[str, str | bytes], name: str = "robot.zip") -> Path:
    path = folder / name
    with warnings.catch_warnings(), zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        warnings.simplefilter("ignore")  # of names that are there twice
        for entry, content in entries.items():
            file.writestr(entry, content)
    return path


@pytest.mark.parametrize(
    "entries",
    [
        {"any.xml": mjcf("m.stl"), "m.stl": BOX},
        {"top/any.xml": mjcf("m.stl"), "top/m.stl": BOX},
        {"any.xml": mjcf("m.stl", '<compiler meshdir="a/b"/>'), "a/b/m.stl": BOX},
        {"any.xml": mjcf("../m.stl", '<compiler meshdir="a"/>'), "m.stl": BOX, "a/x": ""},
        {"scene.xml": '<mujoco><include file="sub/part.xml"/></mujoco>',
         "sub/part.xml": mjcf("m.stl").replace("<mujoco>", "<mujocoinclude>")
         .replace("</mujoco>", "</mujocoinclude>"), "sub/m.stl": BOX},
        {"r.urdf": urdf("meshes/m.stl"), "meshes/m.stl": BOX, "package.xml": "<package/>"},
        {"pkg/urdf/r.urdf": urdf("package://pkg/meshes/m.stl"), "pkg/meshes/m.stl": BOX},
    ],
)  # fmt: skip
def test_scene_lives_on_without_its_folder(tmp_path: Path, entries) -> None:
    path = zipped(tmp_path, entries)
    before = set(Path(tempfile.gettempdir()).glob("orbisim-*"))
    scene = load_scene(path)
    assert set(Path(tempfile.gettempdir()).glob("orbisim-*")) <= before
    assert scene.source == str(path)
    assert scene.model.body("b").mass == pytest.approx(1000)
    assert scene.spec.compile().body("b").mass == pytest.approx(1000)
    again = load_scene(scene.save(tmp_path / "saved"))
    assert again.model.body("b").mass == pytest.approx(1000)


def test_files_of_one_name_stay_apart(tmp_path: Path) -> None:
    text = """<mujoco><asset><mesh name="x" file="x/m.stl"/><mesh name="y" file="y/m.stl"/></asset>
    <worldbody><body name="x"><freejoint/><geom type="mesh" mesh="x"/></body>
    <body name="y"><freejoint/><geom type="mesh" mesh="y"/></body></worldbody></mujoco>"""
    scene = load_scene(zipped(tmp_path, {"s.xml": text, "x/m.stl": BOX, "y/m.stl": LONG}))
    np.testing.assert_allclose(scene.model.body_mass, [0, 1000, 2000], rtol=1e-6)
    np.testing.assert_allclose(scene.spec.compile().body_mass, [0, 1000, 2000], rtol=1e-6)


@pytest.mark.parametrize("suffix", ["zip", "mjz"])
@pytest.mark.parametrize("meshdir", ["", "assets"])
def test_archives_that_mujoco_writes(tmp_path: Path, suffix: str, meshdir: str) -> None:
    text = mjcf("sub/m.stl", f'<compiler meshdir="{meshdir}"/>')
    spec = mujoco.MjSpec.from_string(text, assets={"sub/m.stl": BOX})
    spec.compile()
    path = tmp_path / f"robot.{suffix}"
    spec.to_zip(str(path))
    assert load_scene(path).model.body("b").mass == pytest.approx(1000)


@pytest.mark.parametrize(
    ("entries", "name"),
    [
        ({"scene.xml": EMPTY, "other.xml": EMPTY}, "scene.xml"),
        ({"robot.xml": EMPTY, "other.urdf": EMPTY}, "robot.xml"),
        ({"a/scene.xml": EMPTY, "one.xml": EMPTY}, "one.xml"),
        ({"one.xml": EMPTY, "package.xml": "<?xml version='1.0'?><!-- <robot> --><package/>"},
         "one.xml"),
        ({"b/c/deep.usda": "", "b/c/x.txt": ""}, "b/c/deep.usda"),
    ],
)  # fmt: skip
def test_which_scene(tmp_path: Path, entries, name: str) -> None:
    with archive.extracted(zipped(tmp_path, entries), suffixes()) as scene:
        assert scene.as_posix().endswith("/" + name)
        assert confinement() is not None
    assert confinement() is None


def test_comments_without_end_take_no_time(tmp_path: Path) -> None:
    entries = {f"{i}.xml": "<!--" * 2**14 for i in range(20)} | {"scene.xml": EMPTY}
    watch = Stopwatch()
    assert load_scene(zipped(tmp_path, entries)).model.nbody == 1
    assert watch.seconds < 15


@pytest.mark.parametrize("packing", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_extracting_takes_time_in_proportion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, packing: int
) -> None:
    path = tmp_path / "robot.zip"
    with zipfile.ZipFile(path, "w", packing) as file:
        file.writestr("s.xml", EMPTY)
        file.writestr("m.stl", BOX)
    assert load_scene(path).model.nbody == 1
    monkeypatch.setattr(archive, "MAX_SECONDS", -1.0)
    with pytest.raises(SceneError, match="extracting it took more than"):
        load_scene(path)


@disk
def test_no_room_to_extract_to(
    tmp_path: Path, full_disk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = zipped(tmp_path, {"s.xml": EMPTY, "m.stl": os.urandom(2 * FULL_DISK)})
    monkeypatch.setattr(tempfile, "tempdir", str(full_disk))
    with pytest.raises(OutputError, match="the disk is full"):
        load_scene(path)
    assert not list(full_disk.iterdir())


@pytest.mark.parametrize(
    ("entries", "says"),
    [
        ({}, "holds no scene; expected a file ending in .mjcf, .urdf"),
        ({"readme.txt": "x"}, "holds no scene"),
        ({"a.xml": EMPTY, "b.urdf": EMPTY}, r"holds 2 scenes \(a.xml, b.urdf\).*scene or robot"),
        ({"../s.xml": EMPTY}, r"entry '../s.xml': has a name that leaves"),
        ({"a/../../s.xml": EMPTY}, "leaves the archive"),
        ({"/s.xml": EMPTY}, "leaves the archive"),
        ({"C:\\s.xml": EMPTY}, "leaves the archive"),
        ({"..\\s.xml": EMPTY}, "leaves the archive"),
        ({"s.xml": EMPTY, "zeros": b"\0" * 2**27}, "would extract to"),
        ({"s\n.xml": EMPTY}, "a name that no file can have"),
        ({"s.xml": EMPTY, ".//s.xml": EMPTY}, "is there twice"),
        ({"s.xml": EMPTY, "s.xml/t": EMPTY}, "cannot|no archive"),
        ({"s.xml": mjcf("../m.stl")}, "/robot.zip/s.xml: mesh 'm': refers to '../m.stl', outside"),
        ({"s.xml": mjcf("/etc/passwd")}, "'/etc/passwd', an absolute path"),
        ({"s.xml": mjcf("m.stl", '<compiler meshdir="../.."/>')}, "outside the archive"),
        ({"s.xml": mjcf("m.stl", '<compiler assetdir="/etc"/>')}, "an absolute path"),
        ({"s.xml": '<mujoco><include file="../x.xml"/></mujoco>'}, "<include> .* outside"),
        ({"s.xml": '<mujoco><asset><model file="/x.xml"/></asset></mujoco>'}, "absolute"),
        ({"s.xml": '<mujoco><asset><texture type="2d" name="t" file="../t.png"/></asset></mujoco>'},
         "texture 't': refers to '../t.png'"),
        ({"s.xml": '<mujoco><worldbody><flexcomp name="f" type="mesh" file="../f.obj"/></worldbody>'
          "</mujoco>"}, "flexcomp 'f' .* outside"),
        ({"scene.xml": '<mujoco><include file="x.xml"/></mujoco>',
          "x.xml": '<mujoco><include file="../y.xml"/></mujoco>'}, "robot.zip/x.xml: <include>"),
        ({"r.urdf": urdf("../m.stl")}, "link 'b', collision 1 .* outside the archive"),
        ({"r.urdf": urdf("file:///tmp/m.stl")}, "an absolute path"),
        ({"r.urdf": urdf("package://p/../../m.stl"), "p/x": ""}, "outside the archive"),
        ({"r.urdf": urdf("package://nowhere/m.stl")}, "package 'nowhere' is not found"),
        ({"r.urdf": urdf("m.obj"), "m.obj": "mtllib ../m.mtl\n" + TRIANGLE},
         "mtllib: refers to '../m.mtl'"),
        ({"r.urdf": urdf("m.obj"), "m.obj": "mtllib m.mtl\n" + TRIANGLE,
          "m.mtl": "newmtl a\nmap_Kd ../../secret.png\n"}, "texture map: refers to '../../secret"),
    ],
)  # fmt: skip
def test_what_is_refused(tmp_path: Path, entries, says: str) -> None:
    path = zipped(tmp_path, entries)
    with pytest.raises(SceneError, match=says) as caught:
        load_scene(path)
    assert str(caught.value).startswith(str(path))
    assert "orbisim-" not in str(caught.value).replace(str(tmp_path), "")


def test_package_paths_are_trusted(tmp_path: Path) -> None:
    (tmp_path / "p").mkdir()
    (tmp_path / "p" / "m.stl").write_bytes(BOX)
    path = zipped(tmp_path, {"r.urdf": urdf("package://p/m.stl")})
    scene = load_scene(path, package_paths={"p": tmp_path / "p"})
    assert scene.model.nmesh == 1


def _entry(path: Path, name: str, mode: int, flags: int = 0) -> None:
    entry = zipfile.ZipInfo(name)
    entry.external_attr = mode << 16
    with zipfile.ZipFile(path, "w") as file:
        file.writestr(entry, "/etc/passwd")
    if flags:
        data = bytearray(path.read_bytes())
        for signature, offset in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
            data[data.index(signature) + offset] |= flags
        path.write_bytes(data)


@pytest.mark.parametrize(
    ("mode", "flags", "says"),
    [
        (stat.S_IFLNK | 0o777, 0, "is a link or a device"),
        (stat.S_IFIFO | 0o666, 0, "is a link or a device"),
        (stat.S_IFREG | 0o644, 1, "is encrypted"),
    ],
)
def test_special_entries_are_refused(tmp_path: Path, mode: int, flags: int, says: str) -> None:
    path = tmp_path / "robot.zip"
    _entry(path, "scene.xml", mode, flags)
    with pytest.raises(SceneError, match=says):
        load_scene(path)


def test_an_entry_larger_than_it_says_is_not_written_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archive, "MAX_BYTES", 1000)
    with pytest.raises(SceneError, match="would extract to 2000 bytes"):
        load_scene(zipped(tmp_path, {"s.xml": EMPTY + " " * (2000 - len(EMPTY))}))
    monkeypatch.setattr(archive, "_check_size", lambda entries, path: None)
    with pytest.raises(SceneError, match="more than 1000 bytes"):
        load_scene(zipped(tmp_path, {"s.xml": EMPTY + " " * 2000}))


def test_many_entries_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive, "MAX_ENTRIES", 5)
    with pytest.raises(SceneError, match="holds 6 files; at most 5"):
        load_scene(zipped(tmp_path, {f"{i}.xml": EMPTY for i in range(6)}))


@hypothesis.settings(max_examples=60, deadline=None)
@hypothesis.given(data=st.data())
def test_damaged_archives_are_refused_or_load(data, tmp_path_factory) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("s.xml", mjcf("m.stl"))
        file.writestr("m.stl", BOX)
    damaged = bytearray(buffer.getvalue())
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("zip") / "s.zip"
    path.write_bytes(damaged)
    try:
        load_scene(path)
    except SceneError as error:
        assert "the reader failed" not in str(error)


@pytest.mark.parametrize("name", ["/etc/passwd", "../x", "a/../../x", "~/x", "C:/x", "file:///x"])
def test_confinement(tmp_path: Path, name: str) -> None:
    assert resolve_inside(name, tmp_path, source="s", element="e") == tmp_path / name
    with confined_to(tmp_path), pytest.raises(SceneError, match=r"^s: e: refers to"):
        resolve_inside(name, tmp_path, source="s", element="e")


def test_confinement_sees_through_links(tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    (inside / "link").symlink_to(tmp_path)
    with confined_to(inside), pytest.raises(SceneError, match="outside the archive"):
        resolve_inside("link/secret", inside, source="s", element="e")
