"""Writing recordings: `.npz`, `.csv`, `.parquet`."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.recording import names
from orbisim.recording.contents import Contents
from orbisim.recording.formats import labels
from orbisim.recording.formats.npz import HEADER
from orbisim.recording.formats.parquet import KEY
from orbisim.recording.headers import header_of


def save_npz(recording: Contents, path: Path) -> None:
    """Writes an array for each signal; units and metadata in one more."""
    arrays: dict[str, Any] = {"time": recording.time, **recording.signals}
    arrays[HEADER] = np.array(header_of(recording))
    with path.open("wb") as file:
        np.savez(file, **arrays)


def _columns_of(recording: Contents) -> dict[str, npt.NDArray[np.float64]]:
    table = {"time": recording.time}
    for name, values in recording.signals.items():
        width = None if values.ndim == 1 else values.shape[1]
        parts = [values] if width is None else list(values.T)
        table |= dict(zip(names.columns(name, width), parts, strict=True))
    return table


def save_csv(recording: Contents, path: Path) -> None:
    """Writes a table; numbers keep all their digits.

    A name that looks as if it had a unit gets `[SI]` behind it, so that it is read as it was.
    """
    import pyarrow
    import pyarrow.csv

    columns = _columns_of(recording)
    header = io.StringIO(newline="")
    csv.writer(header, quoting=csv.QUOTE_MINIMAL, lineterminator="\n").writerow(
        map(labels.escaped, columns)
    )
    table = pyarrow.table([pyarrow.array(c) for c in columns.values()], names=list(columns))
    with path.open("wb") as file:
        file.write(header.getvalue().encode())
        options = pyarrow.csv.WriteOptions(include_header=False)
        pyarrow.csv.write_csv(table, file, options)


def save_parquet(recording: Contents, path: Path) -> None:
    """Writes a table, units and metadata in its own metadata."""
    import pyarrow
    import pyarrow.parquet

    columns = _columns_of(recording)
    table = pyarrow.table([pyarrow.array(c) for c in columns.values()], names=list(columns))
    header = {KEY: header_of(recording).encode()}
    pyarrow.parquet.write_table(table.replace_schema_metadata(header), path)
