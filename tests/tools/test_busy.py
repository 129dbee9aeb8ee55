"""tools/busy.py."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).resolve().parents[2] / "tools" / "busy.py"
CHILDREN = """
import os, pathlib
parent = os.getppid()
tasks = pathlib.Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
print(len(tasks) - 1)
raise SystemExit(7)
"""
"""Prints how many processes its parent has beside it."""


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs Linux's /proc")
def test_others_compute_meanwhile_and_the_status_is_the_commands() -> None:
    ran = subprocess.run(
        [sys.executable, TOOL, "--processes", "3", "--", sys.executable, "-c", CHILDREN],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.stdout.startswith("3\n")
    assert "beside 3 busy processes, exit status 7" in ran.stdout
    assert ran.returncode == 7
