"""Temporary folders: gone in the end, and after a kill."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from orbisim.files.temporary import temporary_folder

_LONG_AGO = 3600.0


def _aged(folder: Path) -> Path:
    then = time.time() - _LONG_AGO
    os.utime(folder, (then, then))
    return folder


def test_a_folder_is_gone_in_the_end(tmp_path: Path) -> None:
    with temporary_folder(tmp_path) as folder:
        (folder / "file").write_text("text")
    assert not list(tmp_path.iterdir())
    with pytest.raises(ZeroDivisionError), temporary_folder(tmp_path):
        _ = 1 / 0
    assert not list(tmp_path.iterdir())


def test_folders_of_killed_processes_are_removed(tmp_path: Path) -> None:
    code = (
        "import os, signal\n"
        "from orbisim.files.temporary import temporary_folder\n"
        f"with temporary_folder({str(tmp_path)!r}) as folder:\n"
        "    (folder / 'file').write_text('text')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -9
    (left,) = tmp_path.iterdir()
    with temporary_folder(tmp_path):
        assert left.exists()  # too new to be sure
    _aged(left)
    with temporary_folder(tmp_path):
        assert not left.exists()


def test_folders_in_use_and_of_other_kinds_stay(tmp_path: Path) -> None:
    other = tmp_path / "other-folder"
    other.mkdir()
    (tmp_path / "orbisim-file").write_text("")
    (tmp_path / "orbisim-link").symlink_to(other)
    _aged(other)
    with temporary_folder(tmp_path) as used:
        _aged(used)
        with temporary_folder(tmp_path):
            assert used.exists()
    names = {entry.name for entry in tmp_path.iterdir()}
    assert names == {"other-folder", "orbisim-file", "orbisim-link"}
