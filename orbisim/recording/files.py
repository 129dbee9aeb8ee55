"""Reading and writing recordings."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from orbisim.errors import InputError, RecordingError
from orbisim.files.writing import writing
from orbisim.recording.contents import Contents
from orbisim.recording.conversion import contents_of
from orbisim.recording.formats.log import Array, Log
from orbisim.recording.formats.registry import as_recording_error, open_log
from orbisim.recording.mapping import SignalMap
from orbisim.recording.writers import save_csv, save_npz, save_parquet

_WRITERS = {".npz": save_npz, ".csv": save_csv, ".parquet": save_parquet}

_log = logging.getLogger("orbisim.recording")


def load(path: str | Path, mapping: str | Path | SignalMap | None = None) -> Contents:
    """Reads a recording (see `Recording.load`)."""
    chosen = SignalMap.load(mapping) if isinstance(mapping, (str, Path)) else mapping
    recording = contents_of(opened(path), chosen)
    for note in recording.notes:
        _log.warning("%s: %s", path, note)
    return recording


def opened(path: str | Path) -> Log:
    """A log whose columns raise `RecordingError` where they cannot be read.

    Raises:
      RecordingError: see `orbisim.recording.formats.registry.open_log`.
    """
    log = open_log(path)

    def read(wanted: Sequence[str]) -> Mapping[str, Array]:
        try:
            return log.read(wanted)
        except RecordingError:
            raise
        except InputError as error:
            raise as_recording_error(log.source, error) from None
        except MemoryError:
            problem = "needs more memory than there is"
            raise RecordingError(log.source, problem, element=", ".join(wanted)[:200]) from None

    return dataclasses.replace(log, read=read)


def save(recording: Contents, path: Path) -> None:
    """Writes a recording (see `Recording.save`)."""
    write = _writer(path)
    try:
        with writing(path) as part:
            write(recording, part)
    except InputError as error:
        raise RecordingError(str(path), str(error).removeprefix(f"{path}: ")) from error


def _writer(path: Path) -> Callable[..., Any]:
    if path.suffix.lower() not in _WRITERS:
        raise RecordingError(
            str(path),
            f"a recording is written with one of the suffixes {', '.join(_WRITERS)}; got "
            f"{path.suffix or 'none'!r}",
        )
    return _WRITERS[path.suffix.lower()]
