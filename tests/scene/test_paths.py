"""What people type where a path is asked for."""

from __future__ import annotations

from pathlib import Path

import pytest

from orbisim import load_scene
from orbisim.errors import InputError, SceneError
from orbisim.testing import scenes


def test_the_users_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "scene.xml").write_text(scenes.CARTPOLE)
    assert load_scene("~/scene.xml").model.nq == 2
    assert load_scene(Path("~/scene.xml")).model.nq == 2
    with pytest.raises(SceneError, match=r"did you mean '.*scene\.xml'"):
        load_scene("~/scen.xml")
    with pytest.raises(InputError, match="no such user"):
        load_scene("~nobody_of_this_name/scene.xml")


def test_file_addresses(tmp_path: Path) -> None:
    path = tmp_path / "a scene.xml"
    path.write_text(scenes.CARTPOLE)
    assert load_scene(path.as_uri()).model.nq == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the scene's name is empty"),
        (" \n", "the scene's name is empty"),
        ("https://example.org/robot.urdf", "on the network; download the scene"),
        ("a\0b.xml", "NUL"),
    ],
)
def test_what_is_no_path(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_scene(text)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("robot.mjb", r"compiled MuJoCo model.*from_binary_path"),
        ("robot.urdf.xacro", r"macro document.*xacro robot\.xacro > robot\.urdf"),
        ("robot.STL", "a mesh, not a scene"),
    ],
)
def test_files_that_are_taken_for_scenes(tmp_path: Path, name: str, message: str) -> None:
    (tmp_path / name).write_bytes(b"x")
    with pytest.raises(SceneError, match=message):
        load_scene(tmp_path / name)
