"""Small disks to fill up, for those who may mount them."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

FULL_DISK = 2**18
"""Bytes of the small disk."""


@contextmanager
def mounted(options: str) -> Iterator[Path]:
    """A temporary file system in memory."""
    with tempfile.TemporaryDirectory() as folder:
        command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder]
        subprocess.run(command, check=True, capture_output=True)
        try:
            yield Path(folder)
        finally:
            subprocess.run(["umount", "-l", folder], check=True, capture_output=True)


def _may_mount() -> bool:
    if not hasattr(os, "getuid") or os.getuid() != 0:
        return False
    try:
        with mounted("size=64k"):
            return True
    except (OSError, subprocess.CalledProcessError):
        return False


disk = pytest.mark.skipif(not _may_mount(), reason="file systems cannot be mounted here")
