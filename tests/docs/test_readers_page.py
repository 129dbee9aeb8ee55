"""The reader shown in docs/readers.md is complete: it passes the conformance tests."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from orbisim import load_scene

pytest.importorskip("rod")

PAGE = Path(__file__).parents[2] / "docs" / "readers.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)

namespace: dict[str, Any] = {"__name__": __name__}
for block in BLOCKS:
    exec(compile(block, str(PAGE), "exec"), namespace)
TestSdf = namespace["TestSdf"]


def test_what_the_format_has_and_the_scene_has_not_is_listed(tmp_path: Path) -> None:
    path = tmp_path / "arm.sdf"
    text = TestSdf.document.replace('type="prismatic"', 'type="ball"')
    path.write_text(text.replace("capsule>", "ellipsoid>"))
    kinds = {part.element.partition(" ")[0] for part in load_scene(path).unsupported}
    assert kinds == {"joint", "collision"}
