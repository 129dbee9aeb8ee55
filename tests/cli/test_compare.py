"""`orbisim compare`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from orbisim.cli.main import run
from orbisim.testing import scenes


def output(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    status = run(list(arguments))
    captured = capsys.readouterr()
    return status, captured.out, captured.err


@pytest.fixture
def scene(tmp_path: Path) -> str:
    path = tmp_path / "cartpole.xml"
    path.write_text(scenes.CARTPOLE)
    return str(path)


def test_compare(capsys: pytest.CaptureFixture[str], scene: str, tmp_path: Path) -> None:
    arguments = ["compare", scene, "--b", "mujoco", "--episodes", "2", "--horizon", "0.1"]
    status, out, _ = output(
        capsys, *arguments, "--json", "--out", str(tmp_path / "r"), "--no-video"
    )
    assert status == 0
    assert json.loads(out)["schema"] == "orbisim.compare/1"
    assert (tmp_path / "r" / "report.html").exists()
    status, out, _ = output(capsys, *arguments)
    assert "joint_position" in out
