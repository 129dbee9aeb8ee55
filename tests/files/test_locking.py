"""Locks on folders."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from orbisim.errors import InputError
from orbisim.files.locking import claimed, free, locked


def test_one_holder_at_a_time(tmp_path: Path) -> None:
    assert free(tmp_path)
    with locked(tmp_path):
        assert not free(tmp_path)
        with pytest.raises(BlockingIOError), locked(tmp_path):
            pass
    assert free(tmp_path)


def test_a_claimed_folder_names_what_is_in_the_way(tmp_path: Path) -> None:
    with (
        claimed(tmp_path, "another collection", "wait"),
        pytest.raises(InputError, match="another collection is at work in it; wait"),
        claimed(tmp_path, "another collection", "wait"),
    ):
        pass


def test_a_lock_ends_with_its_process(tmp_path: Path) -> None:
    code = (
        "import os, signal\nfrom pathlib import Path\n"
        "from orbisim.files.locking import locked\n"
        f"with locked(Path({str(tmp_path)!r})):\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -9
    assert free(tmp_path)
