"""`orbisim replay`: what it prints, writes and says."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from orbisim import load_scene
from orbisim.cli.main import run
from orbisim.recording import capture

from ..recording.scenes import EVERYTHING, PENDULUM, simulate


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene and three recordings of it, one of them of a scene with friction."""
    path = tmp_path_factory.mktemp("replay")
    (path / "scene.xml").write_text(EVERYTHING)
    (path / "pendulum.xml").write_text(PENDULUM)
    scene = load_scene(EVERYTHING)
    rubbing = load_scene(EVERYTHING.replace('damping=".05"', 'damping=".05" frictionloss=".2"'))
    capture(scene, simulate(scene, 500)).save(path / "a.npz")
    capture(scene, simulate(scene, 400), rate=100).save(path / "b.csv")
    noisy = capture(rubbing, simulate(rubbing, 500), noise=1e-3)
    noisy.save(path / "c.parquet")
    pendulum = load_scene(PENDULUM)
    capture(pendulum, simulate(pendulum, 200)).save(path / "swing.npz")
    return path


def output(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    status = run([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_json(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    scene, a, b = folder / "scene.xml", folder / "a.npz", folder / "b.csv"
    status, out, _ = output(capsys, "replay", scene, a, b, "--window", "0.2", "--json")
    found = json.loads(out)
    assert status == 0
    assert list(found) == [
        "schema", "scene", "backend", "window_s", "windows", "signals", "overall",
    ]  # fmt: skip
    assert (found["schema"], found["scene"]) == ("orbisim.replay/1", str(scene))
    assert (found["backend"], found["window_s"], found["windows"]) == ("mujoco", 0.2, 9)
    assert set(found["signals"]["qpos/elbow"]) == {"unit", "rms", "median", "p95", "noise"}
    assert found["signals"]["qpos/elbow"]["rms"] < 0.01  # b.csv has every fifth control only


def test_table_and_report(capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path) -> None:
    files = [folder / "scene.xml", folder / "a.npz", folder / "c.parquet"]
    status, out, err = output(capsys, "replay", *files, "--out", tmp_path / "o")
    assert status == 0
    assert "4 windows of 0.5 s" in out
    assert all(name in out for name in ("qpos/elbow", "xquat/cube", "overall rms"))
    assert f"report: {tmp_path / 'o' / 'report.html'}" in err
    report = json.loads((tmp_path / "o" / "report.json").read_text())
    assert report["schema"] == "orbisim.replay/1"
    page = (tmp_path / "o" / "report.html").read_text()
    for text in ("The worst window", "The median window", "qpos/elbow", "c.parquet", "times"):
        assert text in page
    assert page.count("<svg") >= 20
    assert "prefers-color-scheme: dark" in page
    assert 'name="viewport"' in page
    assert not any(f'="{scheme}' in page.replace("http://www.w3.org", "") for scheme in ("http",))


def test_whole_recordings(capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path) -> None:
    files = [folder / "pendulum.xml", folder / "swing.npz"]
    arguments = ["--window", "0", "--out", tmp_path]
    status, out, _ = output(capsys, "replay", *files, *arguments)
    assert status == 0
    assert "1 window of the whole recording" in out
    assert "The recording" in (tmp_path / "report.html").read_text()


def test_what_is_ignored_is_noted_once(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    arrays = dict(np.load(folder / "a.npz")) | {"battery": np.zeros(3)}
    np.savez(tmp_path / "d.npz", **arrays)
    status, out, err = output(capsys, "replay", folder / "scene.xml", tmp_path / "d.npz", "--json")
    assert status == 0
    assert json.loads(out)
    assert err.count("ignored 'battery'") == 1


@pytest.mark.parametrize(
    ("scene", "recording", "options", "message"),
    [
        ("scene.xml", "nothing.npz", [], "nothing.npz: no such file"),
        ("nothing.xml", "a.npz", [], "nothing.xml: no such file"),
        ("scene.xml", "scene.xml", [], "a recording has one of the suffixes"),
        ("scene.xml", "text.npz", [], "text.npz: is not an .npz file"),
        ("scene.xml", "late.csv", [], "late.csv: "),
        ("scene.xml", "empty.csv", [], "empty.csv: the file is empty"),
        ("scene.xml", "timeless.npz", [], "has no 'time'"),
        ("scene.xml", "elbo.npz", [], "did you mean 'elbow'"),
        ("pendulum.xml", "other.npz", [], "'hinge'"),
        ("scene.xml", "a.npz", ["--window", "-1"], "a window lasts 0 s"),
        ("scene.xml", "a.npz", ["--window", "nan"], "a window lasts 0 s"),
        ("scene.xml", "a.npz", ["--backend", "wrap"], "did you mean 'warp'"),
        ("scene.xml", "", [], "RECORDING"),
    ],
)
def test_wrong_input(
    capsys: pytest.CaptureFixture[str],
    folder: Path,
    scene: str,
    recording: str,
    options: list[str],
    message: str,
) -> None:
    time = np.arange(3.0)
    (folder / "text.npz").write_text("hello")
    (folder / "empty.csv").write_text("")
    (folder / "late.csv").write_text("time,qpos/elbow\n0,0\n2,0\n1,0\n")
    np.savez(folder / "timeless.npz", **{"qpos/elbow": time})
    np.savez(folder / "elbo.npz", **{"time": time, "qpos/elbo": time})
    np.savez(folder / "other.npz", **{"time": time, "ctrl/motor": time})
    files = [folder / recording] if recording else []
    status, out, err = output(capsys, "replay", folder / scene, *files, *options)
    assert (status, out) == (2, "")
    assert message in err
    assert err.startswith("error: ")
    assert err.count("\n") == 1
