"""Temporary folders that do not outlive their process for long.

Each is locked as long as it is in use. A process that is killed leaves its folder behind, but not
the lock: whoever makes the next folder of the same kind removes it.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from orbisim.files.locking import free, locked

_NEW = 5.0
"""Seconds for which a folder without a lock is let be: its maker may be about to lock it."""


@contextlib.contextmanager
def temporary_folder(parent: str | Path | None = None, prefix: str = "orbisim-") -> Iterator[Path]:
    """A new folder, gone in the end; removes those of the same kind that killed processes left.

    Args:
      parent: where to make it; the system's place for temporary files if None.
      prefix: of its name; says of which kind it is.

    Raises:
      OSError: it cannot be made.
    """
    place = Path(tempfile.gettempdir() if parent is None else parent)
    _remove_abandoned(place, prefix)
    folder = Path(tempfile.mkdtemp(prefix=prefix, dir=place))
    try:
        with locked(folder):
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _remove_abandoned(place: Path, prefix: str) -> None:
    now = time.time()
    for folder in _folders(place, prefix):
        with contextlib.suppress(OSError):  # somebody else's, or gone meanwhile
            status = folder.lstat()
            mine = not hasattr(os, "getuid") or status.st_uid == os.getuid()
            if mine and now - status.st_mtime > _NEW and free(folder):
                shutil.rmtree(folder, ignore_errors=True)


def _folders(place: Path, prefix: str) -> list[Path]:
    try:
        with os.scandir(place) as entries:
            return [
                Path(entry.path)
                for entry in entries
                if entry.name.startswith(prefix) and entry.is_dir(follow_symlinks=False)
            ]
    except OSError:  # making a folder there will say what is wrong
        return []
