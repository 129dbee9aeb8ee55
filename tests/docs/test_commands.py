"""The tools that the documents name exist, start, and know the options they are called with."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
COMMAND = re.compile(r'python (tools/\w+\.py[^`"\n]*)')


def commands() -> Iterator[tuple[str, ...]]:
    """Path of the tool, and the rest of the line without comments."""
    for document in DOCUMENTS:
        for found in COMMAND.findall(document.read_text()):
            yield tuple(shlex.split(found, comments=True))


def options(tool: str, command: str) -> set[str]:
    """Options in the tool's help; `command` is a subcommand or empty."""
    line = [sys.executable, tool, *([command] if command else []), "--help"]
    ran = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert ran.returncode == 0, ran.stderr
    return set(re.findall(r"--[a-z][a-z-]*", ran.stdout))


def calls() -> dict[tuple[str, str], set[str]]:
    """For each tool and subcommand the options that documents use."""
    found: dict[tuple[str, str], set[str]] = {}
    for tool, *words in commands():
        command = words[0] if words and tool.endswith(("blind_trials.py", "rig_trials.py")) else ""
        used = {word.split("=")[0] for word in words if word.startswith("--")}
        found.setdefault((tool, command), set()).update(used)
    return found


CALLS = calls()


def test_documents_name_tools() -> None:
    assert len(CALLS) > 15


@pytest.mark.parametrize(("tool", "command"), sorted(CALLS))
def test_tool_knows_its_options(tool: str, command: str) -> None:
    assert (ROOT / tool).is_file(), f"no {tool}"
    unknown = CALLS[tool, command] - options(tool, command)
    assert not unknown, f"{tool} {command} does not know {', '.join(sorted(unknown))}"
