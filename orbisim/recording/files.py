"""Reading and writing recordings: `.npz`, `.csv`, `.parquet`."""

from __future__ import annotations

import logging
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError, RecordingError
from orbisim.files.writing import writing
from orbisim.recording import names
from orbisim.recording.contents import Contents
from orbisim.recording.headers import SCHEMA, assemble, header_of, parse_header
from orbisim.recording.tables import load_csv, load_parquet, save_csv, save_parquet

_HEADER = "header"

_log = logging.getLogger("orbisim.recording")


def load(path: Path) -> Contents:
    """Reads a recording (see `Recording.load`)."""
    read = _format(path, _READERS)
    if not path.is_file():
        raise RecordingError(str(path), "no such file" if not path.exists() else "is not a file")
    if path.stat().st_size == 0:
        raise RecordingError(str(path), "the file is empty")
    recording: Contents = read(path)
    for note in recording.notes:
        _log.warning("%s: %s", path, note)
    return recording


def save(recording: Contents, path: Path) -> None:
    """Writes a recording (see `Recording.save`)."""
    write = _format(path, _WRITERS)
    try:
        with writing(path) as part:
            write(recording, part)
    except InputError as error:
        raise RecordingError(str(path), str(error).removeprefix(f"{path}: ")) from error


def _format(path: Path, table: Mapping[str, Any]) -> Callable[..., Any]:
    if path.suffix.lower() not in table:
        raise RecordingError(
            str(path),
            f"a recording has one of the suffixes {', '.join(table)}; got "
            f"{path.suffix or 'none'!r}",
        )
    function: Callable[..., Any] = table[path.suffix.lower()]
    return function


# -- npz -------------------------------------------------------------------------------------------


def _load_npz(path: Path) -> Contents:
    try:
        with np.load(path, allow_pickle=False) as file:
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise ValueError("it holds a single array")
            known = [n for n in file.files if n == "time" or names.is_signal(n)]
            arrays = {name: _member(path, file, name) for name in known}
            header = _npz_header(path, file)
            ignored = [n for n in file.files if n not in arrays and not (n == _HEADER and header)]
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, NotImplementedError) as error:
        if isinstance(error, RecordingError):
            raise
        raise RecordingError(str(path), f"is not an .npz file: {error}") from None
    return assemble(path, arrays, header, ignored)


def _member(path: Path, file: Any, name: str) -> npt.NDArray[Any]:
    try:
        array: npt.NDArray[Any] = file[name]
    except (ValueError, MemoryError, zipfile.BadZipFile, EOFError) as error:
        problem = "needs more memory than there is" if isinstance(error, MemoryError) else error
        raise RecordingError(str(path), f"cannot be read: {problem}", element=repr(name)) from None
    return array


def _npz_header(path: Path, file: Any) -> Mapping[str, Any]:
    """The header that `save` wrote; empty if there is none, or another program's."""
    if _HEADER not in file.files:
        return {}
    text = _member(path, file, _HEADER)
    if text.dtype.kind != "U" or text.ndim or SCHEMA not in str(text):
        return {}
    return parse_header(path, str(text))


def _save_npz(recording: Contents, path: Path) -> None:
    arrays: dict[str, Any] = {"time": recording.time, **recording.signals}
    arrays[_HEADER] = np.array(header_of(recording))
    with path.open("wb") as file:
        np.savez(file, **arrays)


_READERS = {".npz": _load_npz, ".csv": load_csv, ".parquet": load_parquet}
_WRITERS = {".npz": _save_npz, ".csv": save_csv, ".parquet": save_parquet}
