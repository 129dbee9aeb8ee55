"""`orbisim recording`, and --map of the commands that take recordings."""

from __future__ import annotations

import json
import shlex
import subprocess
from pathlib import Path

import numpy as np
import pytest

from orbisim import load_scene
from orbisim.cli.main import run
from orbisim.recording import capture
from tests.scene.urdf.urdf_text import two_links

from ..recording.scenes import PENDULUM, simulate

pd = pytest.importorskip("pandas")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene, and a log of it in milliseconds, degrees and mNm under names of its own."""
    path = tmp_path_factory.mktemp("logs")
    (path / "scene.xml").write_text(PENDULUM)
    scene = load_scene(PENDULUM)
    recording = capture(scene, simulate(scene, 600), rate=100, noise=1e-4)
    pd.DataFrame(
        {
            "timestamp [ms]": np.round(1000 * recording.time).astype(int),
            "yaw_pos [deg]": np.degrees(recording["qpos/hinge"]),
            "yaw_cmd [mNm]": 1e3 * recording["ctrl/motor"],
            "temp": 25.0,
            "state": "ok",
        }
    ).to_csv(path / "log.csv", index=False)
    return path


def output(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    status = run([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_info(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    status, out, err = output(capsys, "recording", "info", folder / "log.csv")
    assert status == 0
    assert all(text in out for text in ("yaw_pos [deg]", "mNm", "timestamp [ms]", "100"))
    assert "Not numbers: 'state'" in out
    assert "'temp' stays at 25" in err


def test_info_with_a_scene(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    arguments = [folder / "log.csv", "--scene", folder / "scene.xml", "--json"]
    status, out, _ = output(capsys, "recording", "info", *arguments)
    found = json.loads(out)
    assert (status, found["schema"]) == (0, "orbisim.recording.info/1")
    signals = {column["name"]: column["signal"] for column in found["columns"]}
    assert signals["yaw_pos [deg]"] == "qpos/hinge?"
    assert found["clocks"][0]["rate_hz"] == pytest.approx(100)
    assert any("does not fit 'pendulum' as it is" in text for text in found["suspicions"])


def test_a_first_map_is_enough(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    log, scene, chosen = folder / "log.csv", folder / "scene.xml", tmp_path / "map.yaml"
    status, _, err = output(capsys, "recording", "init", log, "--scene", scene, "--out", chosen)
    assert status == 0
    assert f"map: {chosen}" in err
    text = chosen.read_text()
    assert '"yaw_pos [deg]": {signal: qpos/hinge, unit: deg' in text
    assert "#   temp:" in text
    status, out, _ = output(capsys, "replay", scene, log, "--map", chosen, "--json")
    assert status == 0
    assert json.loads(out)["overall"]["rms"] < 0.02  # every fifth control
    status, out, _ = output(
        capsys, "recording", "info", log, "--map", chosen, "--scene", scene, "--json"
    )
    found = json.loads(out)
    assert status == 0
    assert {c["name"]: c["unit"] for c in found["columns"]} == {
        "qpos/hinge": "rad", "ctrl/motor": "N*m",
    }  # fmt: skip


def test_init_on_standard_output_and_over_a_file(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    arguments = ["recording", "init", folder / "log.csv", "--scene", folder / "scene.xml"]
    status, out, _ = output(capsys, *arguments, "--out", "-")
    assert (status, out.count("columns:")) == (0, 1)
    status, out, _ = output(capsys, *arguments, "--out", "-", "--json")
    assert json.loads(out)["matched"]["yaw_cmd [mNm]"] == "ctrl/motor"
    (tmp_path / "map.yaml").write_text("mine")
    status, _, err = output(capsys, *arguments, "--out", tmp_path / "map.yaml")
    assert status == 2
    assert "exists; name another file" in err
    assert (tmp_path / "map.yaml").read_text() == "mine"


def test_without_a_map_the_error_names_the_columns(
    capsys: pytest.CaptureFixture[str], folder: Path
) -> None:
    for command in ("replay", "diagnose"):
        status, out, err = output(capsys, command, folder / "scene.xml", folder / "log.csv")
        assert (status, out) == (2, "")
        assert "'yaw_pos [deg]' is 'qpos/hinge'" in err
        assert "orbisim recording init" in err


@pytest.mark.parametrize("command", ["replay", "diagnose"])
def test_a_map_that_is_wrong(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path, command: str
) -> None:
    (tmp_path / "map.yaml").write_text("columns: {yaw: qpos/hinge}")
    status, _, err = output(
        capsys, command, folder / "scene.xml", folder / "log.csv", "--map", tmp_path / "map.yaml"
    )
    assert status == 2
    assert "map.yaml" in err
    assert "unknown column 'yaw'" in err


def test_milliseconds_as_seconds_are_noticed(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    frame = pd.read_csv(folder / "log.csv")
    names = {"timestamp [ms]": "time", "yaw_pos [deg]": "qpos/hinge [deg]"}
    frame.rename(columns=names).to_csv(tmp_path / "log.csv", index=False)
    status, _, err = output(capsys, "replay", folder / "scene.xml", tmp_path / "log.csv")
    assert status == 2
    assert "samples are 10 s apart: if these are ms, name the column 'time [ms]'" in err


def test_the_next_command_can_be_pasted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    limit = "<limit effort='5' velocity='2' lower='-1' upper='1'/>"
    robot, log = tmp_path / "my robot.urdf", tmp_path / "log.csv"
    robot.write_text(two_links("<axis xyz='0 1 0'/>", limit))
    log.write_text("time,joint_pos\n0,0\n0.1,0.2\n0.2,0.1\n")
    options = ["--scene", str(robot), "--actuators", "motor", "--out", str(tmp_path / "map.yaml")]
    assert run(["recording", "init", str(log), *options]) == 0
    hint = capsys.readouterr().err.partition("then: ")[2].strip().removesuffix(")")
    words = shlex.split(hint)
    assert words[:2] == ["orbisim", "replay"] and words[3:5] == [str(log), "--map"]
    assert words[2].startswith(f"{robot}?actuators=motor&")
    done = subprocess.run(["bash", "-c", f"printf '%s\\n' {hint}"], capture_output=True, text=True)
    assert done.stdout.splitlines() == words  # as a shell takes it
