"""The files of a document, before MuJoCo opens them."""

from __future__ import annotations

from pathlib import Path

import mujoco
import pytest

from orbisim.errors import SceneError
from orbisim.scene import mjcf_files
from orbisim.scene.mjcf_files import check_meshes, documents
from orbisim.scene.safety.confine import confined_to

CUBE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def write(path: Path, content: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"<mujoco>{content}</mujoco>")
    return path


def test_documents_that_name_each_other_are_named_once(tmp_path: Path) -> None:
    a = write(tmp_path / "a.xml", "<include file='b.xml'/><include file='gone.xml'/>")
    b = write(tmp_path / "b.xml", "<include file='a.xml'/>")
    assert documents(a) == [a, b]


def test_what_is_not_confined_may_be_anywhere(tmp_path: Path) -> None:
    outside = write(tmp_path / "outside.xml", "")
    inside = write(tmp_path / "in" / "a.xml", "<include file='../outside.xml'/>")
    assert [path.resolve() for path in documents(inside)] == [inside, outside]
    with confined_to(inside.parent), pytest.raises(SceneError, match="outside the archive"):
        documents(inside)


@pytest.mark.parametrize("content", ["<compiler meshdir='/etc'/>", "<include file='/etc/x.xml'/>"])
def test_confined_documents_name_no_absolute_path(tmp_path: Path, content: str) -> None:
    with confined_to(tmp_path), pytest.raises(SceneError, match="absolute path"):
        documents(write(tmp_path / "a.xml", content))


def test_confined_documents_are_safe_xml(tmp_path: Path) -> None:
    broken = tmp_path / "a.xml"
    broken.write_text("<mujoco><")
    assert documents(broken) == [broken]  # MuJoCo will say what is wrong
    with confined_to(tmp_path), pytest.raises(SceneError, match="not well-formed"):
        documents(broken)


def test_chains_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mjcf_files, "_MOST_DOCUMENTS", 3)
    for i in range(4):
        write(tmp_path / f"{i}.xml", f"<include file='{i + 1}.xml'/>")
    with pytest.raises(SceneError, match="more than 3 documents"):
        documents(tmp_path / "0.xml")
    assert len(documents(tmp_path / "2.xml")) == 2


def test_meshes_are_checked_where_the_document_has_them(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text(CUBE)
    spec = mujoco.MjSpec.from_string("<mujoco><asset><mesh file='m.obj'/></asset></mujoco>")
    assert check_meshes(spec, [tmp_path], "s") == ()
    (tmp_path / "m.obj").write_text(f"o one\n{CUBE}o two\n{CUBE}")
    (note,) = check_meshes(spec, [tmp_path], "s")
    assert "'m.obj' holds several objects, of which MuJoCo reads the first" in note
    (tmp_path / "m.obj").write_text(CUBE.replace("f 2 3 4", "f 2 3 9"))
    with pytest.raises(SceneError, match=r"s: mesh 'm': mesh file .*m\.obj.* vertex"):
        check_meshes(spec, [tmp_path], "s")


def test_what_is_missing_is_left_to_mujoco(tmp_path: Path) -> None:
    spec = mujoco.MjSpec.from_string("<mujoco><asset><mesh file='gone.obj'/></asset></mujoco>")
    assert check_meshes(spec, [tmp_path], "s") == ()
