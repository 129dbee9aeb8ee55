"""The examples of docs/viewer.md run as they are printed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


def test_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = (DOCS / "viewer.md").read_text(encoding="utf-8")
    examples = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(examples) == 2
    names: dict[str, object] = {}
    for example in examples:
        exec(compile(example, "viewer.md", "exec"), names)
    assert "half torque" in (tmp_path / "cheetah.html").read_text(encoding="utf-8")


def test_pictures_are_there_and_small() -> None:
    text = (DOCS / "viewer.md").read_text(encoding="utf-8")
    for name in re.findall(r"\]\((images/[^)]+)\)", text):
        assert (DOCS / name).stat().st_size < 150_000
