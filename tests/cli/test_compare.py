"""`orbisim compare`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from orbisim.cli.compare import _interval_row
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


def test_penetration_and_intervals_are_printed(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "box.xml"
    path.write_text(scenes.RESTING_BOX)
    rest = ["--b", "mujoco", "--episodes", "2", "--horizon", "0.1"]
    status, out, _ = output(capsys, "compare", str(path), *rest)
    assert status == 0
    assert "Deepest penetration in all episodes (mm)" in out
    assert "object-world" in out
    entry = {"median": [0.1, 0.2], "p95": [0.3, None]}
    found = {"unit": "m", "interval": entry, "error": entry, "covered_in_all": 0.875}
    row = _interval_row({"name": "box", "position": found}, "position")
    assert row == ("box, position", "m", 0.2, "nan", 0.2, "nan", 87.5)
