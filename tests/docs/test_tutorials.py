"""The tutorials: notebooks stand beside their sources and say the same, and run.

`make tutorials` runs all of them as notebooks; as they are Python, some run here as scripts.
"""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path

import pytest

from tests.test_layers import REPOSITORY

FOLDER = REPOSITORY / "docs" / "tutorials"
SOURCES = sorted(FOLDER.glob("*.py"))
SITE = (REPOSITORY / "mkdocs.yml").read_text()


def cells_of_source(text: str) -> list[str]:
    """Lines of each cell, without the `# ` of text."""
    found = []
    for cell in re.split(r"^# %%", text, flags=re.M)[1:]:
        kind, _, body = cell.partition("\n")
        if kind.strip():  # text, or another language
            body = re.sub(r"^# ?", "", body, flags=re.M)
        found.append(body.strip())
    return found


def cells_of_notebook(path: Path) -> list[str]:
    cells = json.loads(path.read_text())["cells"]
    texts = ("".join(cell["source"]).strip() for cell in cells)
    return [re.sub(r"^%%\w+\n", "", text) for text in texts]


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_the_notebook_is_of_this_source(source: Path) -> None:
    notebook = source.with_suffix(".ipynb")
    assert cells_of_notebook(notebook) == cells_of_source(source.read_text()), "make tutorials"
    assert f"tutorials/{notebook.name}\n" in SITE
    head = source.read_text()[:400]
    assert "# *For who" in head
    assert notebook.stat().st_size < 300_000


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_it_was_run_without_complaints(source: Path) -> None:
    cells = json.loads(source.with_suffix(".ipynb").read_text())["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert all(cell["execution_count"] for cell in code)
    shown = [output for cell in code for output in cell["outputs"]]
    assert not [one for one in shown if one["output_type"] == "error"]
    assert any("image/png" in one.get("data", {}) for one in shown)


@pytest.mark.parametrize("name", ["01_load_and_switch", "06_gradients_and_identification"])
def test_runs(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("torch")
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")
    assert capsys.readouterr().out
