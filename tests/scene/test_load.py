"""What `load_scene` does before a reader has its turn, and strings that are as hostile as files."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from orbisim import load_scene
from orbisim.errors import InputError, SceneError
from orbisim.scene import load
from orbisim.scene.load import named_scene
from tests.clock import Stopwatch

BODY = "<worldbody><body name='b'><geom size='1'/></body></worldbody>"


@pytest.mark.parametrize("inside", ["file" * 25_000, "filename" * 10_000, "<" * 100_000])
def test_long_comments_take_no_time(tmp_path: Path, inside: str) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco><!--{inside}-->{BODY}</mujoco>")
    watch = Stopwatch()
    assert load_scene(path).model.nbody == 2
    assert load_scene(path.read_text()).model.nbody == 2
    assert watch.seconds < 15


@pytest.mark.parametrize("mark", ["<?", "<!", "<!--", "<"])
def test_marks_without_end_take_no_time(tmp_path: Path, mark: str) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(mark * 200_000)
    watch = Stopwatch()
    for source in (path, path.read_text()):
        with pytest.raises(SceneError):
            load_scene(source)
    assert watch.seconds < 15


STRINGS = {
    "keyframes": ("<mujoco><size nkey='2000000000'/><worldbody/></mujoco>", "took|memory"),
    "user data": ("<mujoco><size nuser_body='2000000000'/>" + BODY + "</mujoco>", "took|memory"),
    "replicas": (
        "<mujoco><worldbody><replicate count='1000000000'><geom size='1'/></replicate></worldbody>"
        "</mujoco>",
        "took|memory",
    ),
    "height field": (
        "<mujoco><asset><hfield name='h' nrow='2000000000' ncol='2000000000' size='1 1 1 1'/>"
        "</asset><worldbody><geom type='hfield' hfield='h'/></worldbody></mujoco>",
        "took|memory|refuses",
    ),
    "depth": ("<mujoco>" * 20_000, "refuses|deep"),
    "urdf": ("<robot name='r'>" + "<link>" * 5_000, "deep|well-formed"),
}


@pytest.mark.usefixtures("little_time")
@pytest.mark.parametrize("name", STRINGS)
def test_strings_are_guarded_as_files_are(tmp_path: Path, name: str) -> None:
    text, says = STRINGS[name]
    watch = Stopwatch()
    with pytest.raises(SceneError, match=says) as caught:
        load_scene(text)
    assert "the reader failed" not in str(caught.value)
    assert watch.seconds < 15


@pytest.mark.parametrize("value", ["0", "-0.001", "nan", "inf"])
def test_a_scene_has_a_timestep(tmp_path: Path, value: str) -> None:
    text = f"<mujoco><option timestep='{value}'/>{BODY}</mujoco>"
    path = tmp_path / "scene.xml"
    path.write_text(text)
    for source in (path, text):
        with pytest.raises(SceneError, match=r"timestep|well-formed|refuses"):
            load_scene(source)


def test_a_string_is_tried_once(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[str] = []
    guarded = load.guarded
    monkeypatch.setattr(load, "guarded", lambda *a: (tried.append(a[1]), guarded(*a)))
    monkeypatch.setattr(load, "_passed", {})
    text = f"<mujoco model='once'>{BODY}</mujoco>"
    assert load_scene(text).name == load_scene(text).name == "once"
    assert tried == ["XML string"]
    load_scene(text + " ")
    assert len(tried) == 2
    load_scene(text + "  ", trusted=True)
    assert len(tried) == 2
    for _ in range(2):
        with pytest.raises(SceneError):
            load_scene("<mujoco><geom/></mujoco>")
    assert len(tried) == 4


def test_a_string_that_names_files_is_tried_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    part = tmp_path / "part.xml"
    part.write_text(f"<mujoco>{BODY}</mujoco>")
    text = '<mujoco><include file="part.xml"/></mujoco>'
    assert load_scene(text).model.nbody == 2
    part.write_text("<mujoco><size nuser_body='2000000000'/><worldbody/></mujoco>")
    # which bound is met first depends on how fast the system hands out memory
    with pytest.raises(SceneError, match=r"memory|processor time"):
        load_scene(text)


def test_chains_of_documents(tmp_path: Path) -> None:
    def chain(count: int) -> Path:
        for number in range(count):
            text = f'<mujoco><include file="{number + 1}.xml"/></mujoco>'
            (tmp_path / f"{number}.xml").write_text(text)
        (tmp_path / f"{count}.xml").write_text(f"<mujoco>{BODY}</mujoco>")
        return tmp_path / "0.xml"

    assert load_scene(chain(300)).model.nbody == 2
    for trusted in (False, True):
        with pytest.raises(SceneError, match="more than 1000 documents"):
            load_scene(chain(1500), trusted=trusted)


def test_what_is_no_file_or_too_large(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.xml")
    with pytest.raises(SceneError, match="a pipe or a device"):
        load_scene(tmp_path / "pipe.xml")
    with (tmp_path / "sparse.xml").open("wb") as file:
        file.truncate(30 * 2**30)
    with pytest.raises(SceneError, match=r"has 32212254720 bytes; at most"):
        load_scene(tmp_path / "sparse.xml")


@pytest.mark.parametrize("reference", ['<mesh name="m" file="m.stl"/>', '<include file="m.stl"/>'])
def test_sparse_files_that_a_scene_names(tmp_path: Path, reference: str) -> None:
    with (tmp_path / "m.stl").open("wb") as file:
        file.truncate(30 * 2**30)
    element = f"<asset>{reference}</asset>" if reference.startswith("<mesh") else reference
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco>{element}{BODY}</mujoco>")
    watch = Stopwatch()
    with pytest.raises(SceneError, match=r"m\.stl|memory|took"):
        load_scene(path)
    assert watch.seconds < 20


def test_a_name_that_no_package_knows_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """`task:push` is right, and nothing is registered where the package is only on the path."""
    with pytest.raises(InputError, match=r"got 'x:y' \(names begin with suite:, task:\)"):
        named_scene("x:y", "data.h5")
    monkeypatch.setattr("orbisim.plugins.names", lambda group: ())
    with pytest.raises(InputError, match="no package that knows names is installed"):
        named_scene("task:push", "data.h5")
