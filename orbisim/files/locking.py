"""Locks on folders; they end with the process that holds them, however it ends."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from orbisim.errors import InputError

try:
    import fcntl
except ImportError:  # not POSIX: nothing is locked there
    fcntl = None  # type: ignore[assignment]


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Holds the lock of a folder.

    Raises:
      BlockingIOError: another process holds it.
      OSError: the folder cannot be opened.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        if fcntl is not None:
            _lock(handle)
        yield
    finally:
        os.close(handle)  # lets go of the lock


@contextlib.contextmanager
def claimed(folder: Path, what: str, remedy: str) -> Iterator[None]:
    """Holds the lock of a folder that one process at a time may work in.

    Args:
      folder: which.
      what: the other process would be doing (`another collection`).
      remedy: what to do then.

    Raises:
      InputError: another process holds it.
    """
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(locked(folder))
        except BlockingIOError:
            raise InputError(f"{folder}: {what} is at work in it; {remedy}") from None
        yield


def free(folder: Path) -> bool:
    """Whether no process holds the lock of a folder; True where nothing can be locked.

    Raises:
      OSError: the folder cannot be opened.
    """
    try:
        with locked(folder):
            return True
    except BlockingIOError:
        return False


def _lock(handle: int) -> None:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:  # a file system that knows no locks
        return
