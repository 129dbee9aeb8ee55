"""Scenes that came through the guard are not sent through it again, unless they changed."""

from __future__ import annotations

import time
import zipfile
from pathlib import Path
from typing import Any

import pytest

from orbisim import load_scene
from orbisim.errors import SceneError
from orbisim.files.checked import forget_all
from orbisim.scene import load
from orbisim.scene.safety import meshcheck

CUBE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
SCENE = """
<mujoco><include file="part.xml"/><asset><mesh name="m" file="cube.obj"/></asset>
<worldbody><body><freejoint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>
"""
ROBOT = """
<robot name="r"><link name="l"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0"
ixz="0" iyz="0"/></inertial><collision><geometry><mesh filename="cube.obj"/></geometry></collision>
</link></robot>
"""


@pytest.fixture
def guards(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Which scenes went through the guard."""
    seen: list[str] = []
    real = load.guarded

    def counted(work: Any, source: str, limits: Any) -> Any:
        seen.append(source)
        return real(work, source, limits)

    monkeypatch.setattr(load, "guarded", counted)
    forget_all()
    return seen


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "scene.xml").write_text(SCENE)
    (tmp_path / "robot.urdf").write_text(ROBOT)
    (tmp_path / "part.xml").write_text("<mujoco><option timestep='0.003'/></mujoco>")
    (tmp_path / "cube.obj").write_text(CUBE)
    time.sleep(0.06)
    return tmp_path


@pytest.mark.parametrize("name", ["scene.xml", "robot.urdf"])
def test_the_second_time_needs_no_guard(folder: Path, guards: list[str], name: str) -> None:
    for _ in range(3):
        load_scene(folder / name)
    assert len(guards) == 1
    forget_all()  # as another process
    load_scene(folder / name)
    assert len(guards) == 1


@pytest.mark.parametrize("file", ["scene.xml", "part.xml", "cube.obj"])
def test_any_change_counts(folder: Path, guards: list[str], file: str) -> None:
    load_scene(folder / "scene.xml")
    changed = folder / file
    text = changed.read_text()
    changed.write_text(text.replace("0.003", "0.004").replace("v 1 0 0", "v 2 0 0") + "\n")
    load_scene(folder / "scene.xml")
    assert len(guards) == 2


def test_a_file_that_breaks_is_refused(folder: Path, guards: list[str]) -> None:
    load_scene(folder / "scene.xml")
    (folder / "cube.obj").write_text(CUBE.replace("v 1 0 0", "v nan 0 0"))
    with pytest.raises(SceneError, match="vertex 1 is not finite"):
        load_scene(folder / "scene.xml")
    (folder / "cube.obj").unlink()
    with pytest.raises(SceneError, match=r"cube\.obj"):
        load_scene(folder / "scene.xml")
    assert len(guards) == 3


def test_options_count(folder: Path, guards: list[str]) -> None:
    load_scene(folder / "robot.urdf")
    load_scene(folder / "robot.urdf", floating_base=True)
    assert len(guards) == 2


def test_refused_scenes_are_not_remembered(folder: Path, guards: list[str]) -> None:
    (folder / "scene.xml").write_text("<mujoco><nothing/></mujoco>")
    for _ in range(2):
        with pytest.raises(SceneError):
            load_scene(folder / "scene.xml")
    assert len(guards) == 2


def test_archives_are_always_guarded(folder: Path, guards: list[str]) -> None:
    with zipfile.ZipFile(folder / "all.zip", "w") as archive:
        for name in ("scene.xml", "part.xml", "cube.obj"):
            archive.write(folder / name, name)
    for _ in range(2):
        load_scene(folder / "all.zip")
    assert len(guards) == 2


def test_a_mesh_is_checked_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checks: list[Path] = []
    real = meshcheck.CHECKS[".obj"]
    monkeypatch.setitem(meshcheck.CHECKS, ".obj", lambda path: checks.append(path) or real(path))
    forget_all()
    (folder / "cube.obj").write_text(CUBE + f"# {time.time_ns()}\n")  # not seen by other tests
    for _ in range(3):
        load_scene(folder / "scene.xml", trusted=True)
    (folder / "copy.obj").write_bytes((folder / "cube.obj").read_bytes())
    text = SCENE.replace("cube.obj", "copy.obj")
    (folder / "other.xml").write_text(text)
    load_scene(folder / "other.xml", trusted=True)
    assert len(checks) == 1
