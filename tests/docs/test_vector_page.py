"""The examples of docs/vector.md run."""

from __future__ import annotations

import re

import pytest

from tests.test_layers import REPOSITORY

PAGE = (REPOSITORY / "docs" / "vector.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.S)
EXAMPLES = [e for e in BLOCKS if e.startswith(("import", "from"))]
FEWER = {"range(100)": "range(3)", "64": "4", "n_steps=128": "n_steps=4", "512": "16"}
FEWER |= {"1_000_000": "16", ", verbose=1": ""}


def test_there_are_examples() -> None:
    assert len(EXAMPLES) == 5


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_examples_run(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    if "stable_baselines3" in EXAMPLES[number]:
        pytest.importorskip("stable_baselines3")
    if '"warp"' in EXAMPLES[number]:
        pytest.importorskip("mujoco_warp")
    monkeypatch.chdir(REPOSITORY)
    fewer = EXAMPLES[number]
    for much, little in FEWER.items():
        fewer = fewer.replace(much, little)
    exec(compile(fewer, "docs/vector.md", "exec"), {})
