"""`orbisim view`."""

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


def test_view_writes_a_page(capsys: pytest.CaptureFixture[str], scene: str, tmp_path: Path) -> None:
    pytest.importorskip("meshcat")
    output(capsys, "sim", scene, "--duration", "0.2", "--out", str(tmp_path / "o"))
    saved = str(tmp_path / "o" / "trajectory.npz")
    page = tmp_path / "page.html"
    arguments = ("--trajectory", saved, "--ghost", saved, "--html", str(page), "--json")
    status, out, _ = output(capsys, "view", scene, *arguments)
    assert status == 0
    assert json.loads(out)["file"] == str(page)
    assert page.stat().st_size > 100_000
    status, out, _ = output(capsys, "view", scene, "--no-browser", "--duration", "0.3", "--json")
    assert status == 0
    assert json.loads(out)["url"].startswith("http://127.0.0.1:")
    status, _, err = output(capsys, "view", scene, "--ghost", saved)
    assert status == 2
    assert "--trajectory" in err
