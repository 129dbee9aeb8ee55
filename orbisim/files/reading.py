"""Inputs: what a file declares is checked before memory is given to it.

A file from outside may say that it holds more than it does. `read_bytes` and `read_json` refuse
what is too large or no regular file before they read it, and an `Allowance` adds up what the parts
of one file would take before they are unpacked.
"""

from __future__ import annotations

import json
import stat
from pathlib import Path
from typing import Any

from orbisim.errors import InputError

MEGABYTE = 2**20  # bytes
MOST_JSON = 64 * MEGABYTE
"""Largest JSON document that is read; the largest manifests have some tens of kilobytes."""
FREE = 256 * MEGABYTE
"""What a file may unpack to whatever its own size."""
RATIO = 200
"""Times its own size that a file may unpack to beyond that. Simulated and measured numbers
compress to a half or a third, rendered frames to a fiftieth, zeros to a thousandth."""


def size_of(path: str | Path) -> int:
    """Bytes of a regular file.

    Raises:
      InputError: there is no such file, or it is a folder, a pipe or a device.
    """
    try:
        status = Path(path).stat()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read ({reason})") from None
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe or a device"
        raise InputError(f"{path}: is {kind}; expected a file")
    return status.st_size


def read_bytes(path: str | Path, most: int) -> bytes:
    """The content of a file.

    Args:
      path: the file.
      most: bytes that it may have.

    Raises:
      InputError: it cannot be read, or is larger.
    """
    size = size_of(path)
    if size > most:
        raise InputError(f"{path}: has {size} bytes; at most {most} are read")
    try:
        with Path(path).open("rb") as file:
            return file.read(most)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None


def read_json(path: str | Path, most: int = MOST_JSON) -> dict[str, Any]:
    """A JSON object from a file.

    Raises:
      InputError: it cannot be read, is larger than `most` bytes, or is no JSON object.
    """
    return parse_json(read_bytes(path, most), str(path))


def parse_json(text: str | bytes, source: str) -> dict[str, Any]:
    """A JSON object.

    Args:
      text: the document.
      source: named in errors.

    Raises:
      InputError: it is no JSON object, or one that is nested too deeply.
    """
    try:
        value = json.loads(text)
    except ValueError as error:  # not JSON, not text, or a number of thousands of digits
        raise InputError(f"{source}: is not JSON ({error})") from None
    except RecursionError:
        raise InputError(f"{source}: is JSON that is nested too deeply") from None
    if not isinstance(value, dict):
        raise InputError(f"{source}: expected a JSON object; got {type(value).__name__}")
    return value


class Allowance:
    """How many bytes the parts of a file may unpack to, all together.

    Args:
      path: of the file; named in errors.
      stored: bytes of the file itself.
    """

    def __init__(self, path: str | Path, stored: int) -> None:
        self._path, self._stored = path, stored
        self._most = max(FREE, RATIO * stored)
        self._taken = 0

    def take(self, nbytes: int, part: str) -> None:
        """Counts a part that is about to be unpacked.

        Raises:
          InputError: it is too much for a file of that size.
        """
        self._taken += nbytes
        if self._taken > self._most:
            raise InputError(
                f"{self._path}: {part} would bring what it unpacks to to {self._taken} bytes, out "
                f"of proportion to its own {self._stored}; at most {self._most} are read"
            )
