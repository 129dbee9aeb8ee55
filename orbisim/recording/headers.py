"""The header that `Recording.save` writes: units and metadata as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orbisim.errors import RecordingError
from orbisim.recording.contents import Contents

SCHEMA = "orbisim.recording/1"


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
        if not all(isinstance(unit, str) for unit in units.values()):
            raise ValueError("units must be text")
    except (ValueError, RecursionError) as error:
        raise RecordingError(str(path), f"its header cannot be read: {error}") from None
    return header
