"""The examples of docs/vector.md run."""

from __future__ import annotations

import re

import pytest

from tests.test_layers import REPOSITORY

PAGE = (REPOSITORY / "docs" / "vector.md").read_text()
EXAMPLES = [e for e in re.findall(r"```python\n(.*?)```", PAGE, re.S) if e.startswith("import")]


def test_there_are_examples() -> None:
    assert len(EXAMPLES) == 3


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_examples_run(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(REPOSITORY)
    fewer = EXAMPLES[number].replace("range(100)", "range(3)").replace("64", "4")
    exec(compile(fewer, "docs/vector.md", "exec"), {})
