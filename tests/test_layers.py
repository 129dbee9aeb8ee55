"""What may import what."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import orbisim

CORE = Path(orbisim.__file__).parent
FRONT_ENDS = {"cli/train.py", "cli/eval.py"}  # commands that exist for one backend
BACKENDS = {path.name for path in (CORE.parent / "backends").glob("orbisim_*")}


def imports_of(path: Path) -> Iterator[str]:
    """Top-level packages that a file imports, anywhere in it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield (node.module or "").partition(".")[0]


def test_the_core_imports_no_backend() -> None:
    assert {"orbisim_mujoco", "orbisim_warp", "orbisim_world_model"} <= BACKENDS
    found = {
        name: names
        for path in CORE.rglob("*.py")
        if (name := path.relative_to(CORE).as_posix()) not in FRONT_ENDS
        and (names := BACKENDS & set(imports_of(path)))
    }
    assert not found
