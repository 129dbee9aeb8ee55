"""The scripts of docs/examples run as they are, and are short."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

from tests.test_layers import REPOSITORY

SCRIPTS = sorted((REPOSITORY / "docs" / "examples").glob("*.py"))
QUICK = {"switch": r"apart by \S+", "many_worlds": r"\(16, 100, \d\) diverged: False"}
SLOW = {
    "compare": r"report\.html",
    "diagnose": r"'elbow' lacks Coulomb friction",
    "gradients": r"   squared distance to the goal 0\.00\d+ rad",
}


def test_there_are_five_and_they_are_short() -> None:
    assert {path.stem for path in SCRIPTS} == {*QUICK, *SLOW}
    assert all(len(path.read_text().splitlines()) <= 40 for path in SCRIPTS)


def ran(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch")
    (folder / "mjcf_assets").symlink_to(REPOSITORY / "mjcf_assets")
    monkeypatch.chdir(folder)
    runpy.run_path(str(REPOSITORY / "docs" / "examples" / f"{name}.py"), run_name="__main__")


@pytest.mark.parametrize("name", QUICK)
def test_quick(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran(name, tmp_path, monkeypatch)
    assert re.search(QUICK[name], capsys.readouterr().out)


@pytest.mark.slow
@pytest.mark.parametrize("name", SLOW)
def test_slow(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran(name, tmp_path, monkeypatch)
    assert re.search(SLOW[name], capsys.readouterr().out)
