"""What the file formats share: the header that `save` writes, and the making of a recording."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.errors import RecordingError
from orbisim.recording import names
from orbisim.recording.contents import Contents

SCHEMA = "orbisim.recording/1"


def assemble(
    path: Path,
    arrays: Mapping[str, npt.ArrayLike],
    header: Mapping[str, Any],
    ignored: Iterable[str],
) -> Contents:
    """A recording from the arrays of a file.

    Raises:
      RecordingError: there is no time, or an array does not fit.
    """
    if "time" not in arrays:
        raise RecordingError(
            str(path), "has no 'time'", remedy="give the time of each sample in seconds"
        )
    own = {name: _as_own(values) for name, values in arrays.items()}
    return Contents(
        time=own.pop("time"),
        signals=own,
        units=header.get("units", {}),
        metadata=header.get("metadata", {}),
        source=str(path),
        notes=tuple(_ignored_note(name) for name in ignored),
    )


def _as_own(values: npt.ArrayLike) -> npt.NDArray[Any]:
    """An array that nobody else writes into, so that it need not be copied."""
    array = np.asarray(values)
    array.flags.writeable = False
    return array


def _ignored_note(name: str) -> str:
    kind, _, target = name.partition("/")
    if not target and kind in names.KINDS:
        return f"ignored {name!r}: a signal is named {kind}/<{names.KINDS[kind]}>"
    return f"ignored {name!r}: not the name of a signal"


def header_of(recording: Contents) -> str:
    """Units and metadata as JSON.

    Raises:
      RecordingError: the metadata are no JSON values.
    """
    header = {
        "schema": SCHEMA,
        "units": dict(recording.units),
        "metadata": dict(recording.metadata),
    }
    try:
        return json.dumps(header)
    except TypeError as error:
        raise RecordingError(recording.source, f"metadata cannot be saved: {error}") from None


def parse_header(path: Path, text: str | bytes) -> Mapping[str, Any]:
    """Units and metadata that `save` wrote."""
    try:
        header = json.loads(text)
        if not (isinstance(header, dict) and header.get("schema") == SCHEMA):
            raise ValueError("unknown schema")
        units, metadata = header.get("units", {}), header.get("metadata", {})
        if not (isinstance(units, dict) and isinstance(metadata, dict)):
            raise ValueError("units and metadata must be objects")
    except ValueError as error:
        raise RecordingError(str(path), f"its header cannot be read: {error}") from None
    return header
