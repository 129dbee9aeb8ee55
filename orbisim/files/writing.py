"""Outputs: a file appears under its own name when it is whole, or not at all.

It is written into a hidden folder beside its place, sent to the disk, and renamed. What stood
there before stays until then, and for good where the work fails. A disk that is full or a folder
that cannot be written to is an error that names the file.
"""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from orbisim.errors import InputError, OrbiSimError, OutputError
from orbisim.files.temporary import temporary_folder

log = logging.getLogger("orbisim.files")
"""Says at level INFO which file was replaced; the command line prints it."""

_FULL = (errno.ENOSPC, errno.EDQUOT)
_WRONG_PLACE = (
    *(errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOENT, errno.ENOTDIR, errno.EISDIR),
    *(errno.EEXIST, errno.ENAMETOOLONG, errno.ELOOP, errno.EINVAL, errno.ENXIO),
)
"""What a place is wrong by; another place would be right."""
_NO_SPACE = "No space left on device"


@contextlib.contextmanager
def writing(path: str | Path, *, announce: bool = True) -> Iterator[Path]:
    """Gives a path to write to; in the end, the file appears under its own name.

    A file that stands there is replaced, keeping its permissions. A link is followed; a device or
    a pipe is written to as it is.

    Args:
      path: where the file is to appear.
      announce: whether to log that a file was replaced.

    Raises:
      InputError: no file can be written there.
      OutputError: the disk is full, or writing failed otherwise.
    """
    target = Path(path)
    with output_errors(target):
        place = Path(os.path.realpath(target))
        if _is_special(place):
            yield place
            return
        with temporary_folder(place.parent, f".{place.name[:100]}.part-") as folder:
            part = folder / place.name
            yield part
            replaced = place.exists()
            if replaced:
                shutil.copymode(place, part)
            synced(part)
            part.replace(place)
            synced(place.parent)
    if replaced and announce:
        log.info("%s: replaced", target)


def write_bytes(path: str | Path, data: bytes, *, announce: bool = True) -> None:
    """Writes a file (see `writing`)."""
    with writing(path, announce=announce) as part:
        part.write_bytes(data)


def write_text(path: str | Path, text: str, *, announce: bool = True) -> None:
    """Writes a file in UTF-8 (see `writing`)."""
    write_bytes(path, text.encode("utf-8"), announce=announce)


def write_json(path: str | Path, value: Any, *, announce: bool = True) -> None:
    """Writes JSON without NaN and infinity (see `writing`).

    Raises:
      ValueError: the value has a NaN or an infinity.
    """
    text = json.dumps(value, indent=1, allow_nan=False)
    write_text(path, text + "\n", announce=announce)


def make_folder(path: str | Path) -> Path:
    """Makes a folder and those above it, if they are not there; returns it.

    Raises:
      InputError: there is a file of that name, or no folder can be made there.
      OutputError: the disk is full.
    """
    folder = Path(path)
    with output_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def check_folder(path: str | Path) -> None:
    """Raises `InputError` if a folder is not there and cannot be made, or cannot be written to.

    Makes nothing.
    """
    folder = Path(path).absolute()
    above = next((place for place in (folder, *folder.parents) if _is_there(place)), folder)
    if not above.is_dir():
        raise InputError(f"{path}: {above} is not a folder; name a folder to write to")
    if not os.access(above, os.W_OK | os.X_OK):
        raise InputError(f"{path}: the folder {above} cannot be written to; choose another")


def check_place(path: str | Path) -> None:
    """Raises `InputError` if a file cannot be written there. Writes nothing."""
    place = Path(path)
    if place.is_dir():
        raise InputError(f"{path}: is a folder; name a file to write to")
    if not _is_there(place.absolute().parent):
        raise InputError(f"{path}: there is no folder {str(place.parent)!r}")
    if not _is_special(place):
        check_folder(place.parent)


def synced(path: Path) -> None:
    """Sends a file, or the entries of a folder, to the disk.

    Raises:
      OSError: that failed; for a folder only if the disk is to blame.
    """
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno != errno.EINVAL:  # a file system that cannot do it for folders
            raise
    finally:
        os.close(handle)


@contextlib.contextmanager
def output_errors(path: Path) -> Iterator[None]:
    """Turns what the system has against writing a file into an error that names it."""
    try:
        yield
    except OrbiSimError:
        raise
    except Exception as error:  # safetensors, HDF5 and ffmpeg have errors of their own for it
        found = _as_output_error(path, error)
        if found is None:
            raise
        raise found from error


def _as_output_error(path: Path, error: Exception) -> OrbiSimError | None:
    number = getattr(error, "errno", None) if isinstance(error, OSError) else None
    reason = getattr(error, "strerror", None) or " ".join(str(error).split())[:200]
    if number in _WRONG_PLACE:
        return InputError(f"{path}: cannot be written ({reason}); choose another place")
    if number in _FULL or _NO_SPACE in str(error):
        return OutputError(f"{path}: the disk is full; make room and run it again")
    if not isinstance(error, (OSError, RuntimeError)):
        return None
    if _is_crammed(path):
        return OutputError(f"{path}: the disk is full; make room and run it again ({reason})")
    if not isinstance(error, OSError):
        return None
    return OutputError(f"{path}: cannot be written ({reason or type(error).__name__})")


def _is_crammed(path: Path) -> bool:
    """Whether there is no room left where a file is to be written."""
    above = next((place for place in path.absolute().parents if _is_there(place)), Path("/"))
    try:
        room = os.statvfs(above)
    except (AttributeError, OSError):
        return False
    return room.f_blocks > 0 and room.f_bavail == 0


def _is_special(path: Path) -> bool:
    try:
        return not stat.S_ISREG(path.stat().st_mode) and not path.is_dir()
    except OSError:
        return False


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a name that no file can have, or a folder that cannot be looked into
        return False
