"""The backend shown in backends/README.md is complete: it passes the conformance tests."""

from __future__ import annotations

import re
from pathlib import Path

from orbisim.registry import register_backend

README = Path(__file__).parents[2] / "backends" / "README.md"
BLOCKS = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)

namespace: dict[str, object] = {"__name__": __name__}
exec(compile(BLOCKS[0], str(README), "exec"), namespace)
register_backend("euler", namespace["EulerBackend"])  # type: ignore[arg-type]
exec(compile(BLOCKS[1], str(README), "exec"), namespace)
TestEuler = namespace["TestEuler"]


def test_it_is_about_sixty_lines() -> None:
    assert len(BLOCKS[0].splitlines()) <= 65
