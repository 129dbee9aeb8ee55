"""Mesh files that MuJoCo decodes are checked, each content once."""

from __future__ import annotations

from pathlib import Path

import pytest

from orbisim.errors import SceneError
from orbisim.files.checked import forget_all
from orbisim.scene.safety import meshcheck
from orbisim.scene.safety.confine import confined_to
from orbisim.scene.safety.meshcheck import Blame, check_native_mesh
from orbisim.scene.safety.meshformats import CHECKS, Findings
from orbisim.scene.safety.problem import MeshProblemError

CUBE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture
def checks(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Path]:
    """Which files were really looked at."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    forget_all()
    seen: list[Path] = []

    def counted(path: Path) -> Findings:
        seen.append(path)
        return CHECKS[".obj"](path)

    monkeypatch.setattr(meshcheck, "CHECKS", {**CHECKS, ".obj": counted})
    return seen


def test_each_content_once(checks: list[Path], tmp_path: Path) -> None:
    for name in ("a.obj", "b.obj"):
        (tmp_path / name).write_text(f"o one\n{CUBE}o two\n{CUBE}")
        for _ in range(2):
            assert check_native_mesh(tmp_path / name) == Findings(several_objects=True)
    assert checks == [tmp_path / "a.obj"]
    (tmp_path / "a.obj").write_text(CUBE)
    assert check_native_mesh(tmp_path / "a.obj") == Findings()
    assert len(checks) == 2


def test_what_is_refused_is_refused_again(checks: list[Path], tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(CUBE.replace("f 2 3 4", "f 2 3 9"))
    for _ in range(2):
        with pytest.raises(SceneError, match="a face with vertex 9"):
            check_native_mesh(tmp_path / "a.obj")
    assert len(checks) == 2


def test_of_an_archive_each_time(checks: list[Path], tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(CUBE)
    with confined_to(tmp_path):
        for _ in range(2):
            check_native_mesh(tmp_path / "a.obj")
    assert len(checks) == 2


def test_other_suffixes(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(b"ply")
    with pytest.raises(SceneError, match=r"suffix '.ply'; expected one of .stl, .obj, .msh"):
        check_native_mesh(tmp_path / "a.ply")


def test_who_is_to_blame() -> None:
    with pytest.raises(SceneError) as caught, Blame(Path("m.obj"), "scene.xml", "mesh 'm'"):
        raise MeshProblemError("is empty")
    assert "scene.xml: mesh 'm': mesh file 'm.obj' is empty" in str(caught.value)
    assert "repair or replace the mesh file" in str(caught.value)
    remedy = r"m\.obj.*is a pointer.*run git lfs pull"
    with pytest.raises(SceneError, match=remedy), Blame(Path("m.obj"), None, None):
        raise MeshProblemError("is a pointer", "run git lfs pull")
    with pytest.raises(SceneError, match="cannot be read: gone"), Blame(Path("m"), None, None):
        raise FileNotFoundError(2, "gone")
    with pytest.raises(KeyError), Blame(Path("m"), None, None):
        raise KeyError
