"""`.npz` files from outside, unpacked within bounds."""

from __future__ import annotations

import contextlib
import io
import math
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError
from orbisim.files.reading import Allowance, size_of

_SUFFIX = ".npy"
_MOST_HEADER = 10_000
"""Bytes of an array's header; NumPy's own limit, beyond which parsing it may take long."""


class Npz(Mapping[str, npt.NDArray[Any]]):
    """The arrays of a file by name, each read when it is asked for.

    Args:
      path: the file, named in errors.
      archive: the open archive.
      size: bytes of the file.
    """

    def __init__(self, path: str | Path, archive: zipfile.ZipFile, size: int) -> None:
        self._path, self._archive = path, archive
        self._entries = {i.filename.removesuffix(_SUFFIX): i for i in archive.infolist()}
        self._allowance = Allowance(path, size)

    def __len__(self) -> int:
        return len(self._entries)

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        """An array.

        Raises:
          KeyError: there is none of that name.
          InputError: it is damaged, holds no numbers or text, or declares more than the file has.
        """
        entry = self._entries[name]
        self._allowance.take(entry.file_size, repr(name))
        try:
            with self._archive.open(entry) as member:
                _check_header(member, entry.file_size)
            with self._archive.open(entry) as member:
                array: npt.NDArray[Any] = np.lib.format.read_array(member, allow_pickle=False)
                if member.read(1):
                    raise ValueError("it is followed by something else")
                return array
        except Exception as error:  # zlib, bz2, lzma and zipfile each have errors of their own
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            raise InputError(f"{self._path}: {name!r} cannot be read ({reason})") from None


@contextlib.contextmanager
def opened(path: str | Path) -> Iterator[Npz]:
    """Opens a file of arrays.

    Raises:
      InputError: there is no such file, or it is no `.npz` file.
    """
    size = size_of(path)
    try:
        archive = zipfile.ZipFile(path)
    except Exception as error:  # as above
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path}: is not an .npz file ({reason})") from None
    with archive:
        yield Npz(path, archive, size)


def _check_header(member: Any, nbytes: int) -> None:
    """Raises `ValueError` if an array declares more than its entry holds, or holds objects."""
    head = io.BytesIO(member.read(min(nbytes, _MOST_HEADER + 128)))
    version = np.lib.format.read_magic(head)
    reader = np.lib.format.read_array_header_1_0
    if version != (1, 0):
        reader = np.lib.format.read_array_header_2_0
    shape, _, dtype = reader(head, max_header_size=_MOST_HEADER)
    if dtype.hasobject:
        raise ValueError("it holds Python objects")
    if math.prod(shape) * dtype.itemsize > nbytes:
        raise ValueError(f"it declares the shape {shape}, more than is there")
