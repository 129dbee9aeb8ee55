"""Commands that are killed: what counts as bad, and a small sample."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.disks import disk

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
import kill_commands


def test_half_files_are_seen(tmp_path: Path) -> None:
    np.savez(tmp_path / "whole.npz", a=np.zeros(1000))
    whole = (tmp_path / "whole.npz").read_bytes()
    (tmp_path / "half.npz").write_bytes(whole[:-50])
    (tmp_path / "report.json").write_text('{"a": 1')
    (tmp_path / "report.html").write_text("<html><body>")
    (tmp_path / "a.h5").write_bytes(b"\x89HDF")
    (tmp_path / ".part-x").mkdir()
    (tmp_path / ".part-x" / "b.npz").write_bytes(b"")
    (tmp_path / "a.h5.partial").mkdir()
    (tmp_path / "a.h5.partial" / "c.h5").write_bytes(b"")
    bad = sorted(kill_commands.half_files(tmp_path))
    assert bad == ["a.h5", "half.npz", "report.html", "report.json"]


def test_processes_that_are_left_are_seen() -> None:
    child = kill_commands.start(["--help"], f"test-{os.getpid()}")
    child.communicate()
    assert kill_commands.left(f"test-{os.getpid()}") == []
    assert kill_commands.left(os.environ.get("ORBISIM_KILL_TRIAL", "none")) == []


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_a_collection_that_is_killed(tmp_path: Path, how: signal.Signals) -> None:
    duration, expected = kill_commands.undisturbed("collect", tmp_path, tmp_path)
    assert kill_commands.trial("collect", how, duration / 2, tmp_path, expected) == []


@disk
@pytest.mark.slow
@pytest.mark.parametrize("options", ["size=64k", "ro"])
def test_a_simulation_without_a_place(tmp_path: Path, options: str) -> None:
    assert kill_commands.cornered("sim", options, tmp_path) == []
