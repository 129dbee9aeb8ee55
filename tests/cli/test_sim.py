"""`orbisim sim`."""

from __future__ import annotations

import json
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

from orbisim import Trajectory
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


def test_sim(capsys: pytest.CaptureFixture[str], scene: str, tmp_path: Path) -> None:
    arguments = ["sim", scene, "--duration", "0.5", "--worlds", "3", "--controls", "random"]
    status, out, _ = output(
        capsys, *arguments, "--seed", "4", "--out", str(tmp_path / "o"), "--json"
    )
    result = json.loads(out)
    assert status == 0
    assert (result["steps"], result["worlds"], result["diverged"]) == (100, 3, 0)
    trajectory, notes = Trajectory.load(tmp_path / "o" / "trajectory.npz")
    assert trajectory.qpos.shape == (3, 100, 2)
    assert notes["seed"] == 4
    output(capsys, *arguments, "--seed", "4", "--out", str(tmp_path / "p"))
    again, _ = Trajectory.load(tmp_path / "p" / "trajectory.npz")
    np.testing.assert_array_equal(again.qpos, trajectory.qpos)


def test_sim_makes_a_video(capsys: pytest.CaptureFixture[str], scene: str, tmp_path: Path) -> None:
    arguments = ("--duration", "0.2", "--size", "64x96", "--out", str(tmp_path / "o"), "--json")
    status, out, _ = output(capsys, "sim", scene, "--renderer", "null", *arguments)
    assert status == 0
    frames = iio.imread(tmp_path / "o" / "video.mp4", plugin="FFMPEG")
    assert frames.shape[1:] == (64, 96, 3)
    assert 6 <= len(frames) <= 8
    assert json.loads(out)["files"][1].endswith("video.mp4")


def test_without_a_folder_nothing_is_written(
    capsys: pytest.CaptureFixture[str], scene: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    status, out, _ = output(capsys, "sim", scene, "--duration", "0.1", "--json")
    assert status == 0
    assert json.loads(out)["files"] == []
    assert not list(Path.cwd().iterdir())
