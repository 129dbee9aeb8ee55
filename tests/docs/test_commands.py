"""The tools that the documents name exist, start, and know the options they are called with."""

from __future__ import annotations

import contextlib
import io
import itertools
import multiprocessing
import os
import re
import runpy
import shlex
import sys
import traceback
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path

import orbisim_world_model.run  # noqa: F401 (most tools import torch: once, here)
import pytest

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
COMMANDED = ("_trials.py", "real_camera.py", "clone_stack.py")
"""Tools whose first word is a subcommand with options of its own."""
COMMAND = re.compile(r'python (tools/\w+\.py[^`"\n]*)')


def commands() -> Iterator[tuple[str, ...]]:
    """Path of the tool, and the rest of the line without comments."""
    for document in DOCUMENTS:
        for found in COMMAND.findall(document.read_text()):
            yield tuple(shlex.split(found, comments=True))


def options(tool: str, command: str) -> set[str]:
    """Options in the tool's help; `command` is a subcommand or empty."""
    words = [tool, *([command] if command else []), "--help"]
    receive, send = _FORK.Pipe(duplex=False)
    child = _FORK.Process(target=_run, args=(words, send))
    child.start()
    send.close()
    status, said, error = receive.recv()
    child.join()
    assert status == 0, error
    return set(re.findall(r"--[a-z][a-z-]*", said))


_FORK = multiprocessing.get_context("fork")
"""What is imported here is not imported again for each tool."""


def _run(words: list[str], send: Connection) -> None:
    """A tool's program in a process of its own; sends status and what it writes."""
    os.chdir(ROOT)
    sys.argv = words
    sys.path.insert(0, str(ROOT / "tools"))
    status: int | str | None = 0
    said, error = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(error):
        try:
            runpy.run_path(str(ROOT / words[0]), run_name="__main__")
        except SystemExit as end:
            status = end.code
        except BaseException:
            status = traceback.format_exc()
    send.send((status or 0, said.getvalue(), error.getvalue() + str(status)))


def calls() -> dict[tuple[str, str], set[str]]:
    """For each tool and subcommand the options that documents use."""
    found: dict[tuple[str, str], set[str]] = {}
    for tool, *words in commands():
        command = words[0] if words and tool.endswith(COMMANDED) else ""
        own = itertools.takewhile(lambda word: word != "--", words)  # another command follows
        used = {word.split("=")[0] for word in own if word.startswith("--")}
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
