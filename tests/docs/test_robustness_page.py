"""The tests that docs/robustness.md names are there."""

from __future__ import annotations

import re
from pathlib import Path

TESTS = Path(__file__).parents[1]
CONFORMANCE = TESTS.parent / "orbisim" / "testing" / "backend.py"
PAGE = TESTS.parent / "docs" / "robustness.md"


def named() -> list[tuple[Path, str]]:
    """Files and functions (or nothing, where a file is named alone)."""
    found, file = [], Path()
    for text in re.findall(r"`([^`\s]+)`", PAGE.read_text()):
        place, colon, name = text.rpartition(":")
        if place == "conformance":
            found.append((CONFORMANCE, name))
        elif colon and name.startswith("test_"):
            file = TESTS / place.rstrip(":") if place != ":" else file
            found.append((file, name))
        elif text.endswith(".py") and "test_" in text:
            found.append((TESTS / text, ""))
    return found


def test_they_are_there() -> None:
    assert len(named()) > 60
    missing = [
        f"{file}::{name}"
        for file, name in named()
        if not file.is_file() or (name and f"def {name}(" not in file.read_text())
    ]
    assert not missing
