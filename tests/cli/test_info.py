"""`orbisim info`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from orbisim.cli.info import _row, _trimmed
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


def test_info(capsys: pytest.CaptureFixture[str], scene: str) -> None:
    status, out, _ = output(capsys, "info", scene)
    assert status == 0
    assert all(
        word in out for word in ("cart", "pole", "hinge", "motor", "gravity") if word != "motor"
    )
    status, out, err = output(capsys, "info", scene, "--json")
    result = json.loads(out)
    assert (status, err) == (0, "")
    assert result["schema"] == "orbisim.info/1"
    assert result["entities"][1]["kind"] == "robot"
    assert result["unsupported"] == []


def test_what_a_scene_cannot_carry_is_said(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    robot = tmp_path / "r.urdf"
    robot.write_text(
        "<robot name='r'><link name='l'><inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1'"
        "/></inertial></link><gazebo/></robot>"
    )
    status, out, err = output(capsys, "info", str(robot))
    assert status == 0
    assert "unsupported: " in err
    assert "gazebo" in err
    status, out, _ = output(capsys, "info", str(robot), "--json")
    (item,) = json.loads(out)["unsupported"]
    assert item["feature"] == "<gazebo> in <robot>"


def test_numbers_in_rows() -> None:
    assert _row([1.0, 0.123456, "name"]) == "1 0.1235 name"
    assert _row([]) == "none"
    assert _trimmed([1.0, 0.0, 2.0, 0.0]) == [1.0, 0.0, 2.0]
    assert _trimmed([0.0, 0.0]) == [0.0]
