"""`orbisim view`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from orbisim import view
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


def test_a_page_plays_what_is_simulated(
    capsys: pytest.CaptureFixture[str], scene: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("meshcat")
    shown = []
    save = view.save_html
    monkeypatch.setattr(
        view, "save_html", lambda p, s, t, **o: (shown.append(t), save(p, s, t, **o))[1]
    )
    page = str(tmp_path / "page.html")
    options = ("--controls", "random", "--duration", "0.2")
    for more in (options, ("--backend", "mujoco")):
        status, _, err = output(capsys, "view", scene, "--html", page, *more)
        assert (status, err) == (0, "")
    assert shown[0].qpos.shape == (1, 40, 2) and np.ptp(shown[0].qpos[0, :, 0]) > 0
    assert shown[1] is None  # as it is
