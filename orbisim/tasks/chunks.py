"""The parts of an unfinished collection: a folder of files that are whole, or not there.

The name of a chunk's file ends in a hash of its content, so that one that was damaged since is
noticed when the collection goes on.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from pathlib import Path

from orbisim.errors import InputError
from orbisim.files.temporary import temporary_folder
from orbisim.files.writing import make_folder, output_errors, synced, write_text
from orbisim.tasks.orders import Order, write_episodes

_LABEL = "order"
_PIECE = 2**20  # bytes read at once: a chunk may be larger than memory

log = logging.getLogger("orbisim.tasks")


def prepare(folder: Path, order: Order) -> None:
    """Makes the folder, new or left by an earlier run of the same order.

    Raises:
      InputError: it is there and holds something else, or cannot be made.
    """
    make_folder(folder)
    label = folder / _LABEL
    if not label.exists():
        if any(not entry.name.startswith(".") for entry in folder.iterdir()):
            raise InputError(f"{folder}: is not an unfinished collection; move it out of the way")
        write_text(label, order.key)
    elif label.read_text(errors="replace") != order.key:
        raise InputError(
            f"{folder}: holds an unfinished collection of something else; finish it by the same "
            "command as before, or remove it"
        )


def finished(folder: Path, numbers: Sequence[int]) -> Path | None:
    """The file of the episodes with these numbers; None if there is none that is whole.

    One that is damaged is set aside, under a name that ends in `.damaged`.
    """
    for path in sorted(folder.glob(f"{_stem(numbers)}-*.h5")):
        if path.stem == f"{_stem(numbers)}-{_digest(path)}":
            return path
        log.warning("%s: is damaged; its episodes are collected anew", path)
        path.replace(path.with_name(path.name + ".damaged"))
    return None


def make_chunk(order: Order, numbers: Sequence[int], folder: Path) -> None:
    """Makes the episodes of those numbers and puts them into the folder.

    Raises:
      OutputError: the disk is full.
    """
    with output_errors(folder / _stem(numbers)), temporary_folder(folder, ".chunk-") as scratch:
        part = scratch / "chunk.h5"
        write_episodes(order, numbers, part)
        keep(part, numbers, folder)


def keep(part: Path, numbers: Sequence[int], folder: Path) -> None:
    """Moves a file of the episodes with these numbers, which is whole, into the folder.

    Raises:
      OSError: the disk is to blame.
    """
    synced(part)
    part.replace(folder / f"{_stem(numbers)}-{_digest(part)}.h5")
    synced(folder)


def _stem(numbers: Sequence[int]) -> str:
    return f"chunk-{numbers[0]:06d}"


def _digest(path: Path) -> str:
    found = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(_PIECE):
            found.update(piece)
    return found.hexdigest()[:16]
