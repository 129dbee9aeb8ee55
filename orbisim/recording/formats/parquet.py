"""`.parquet`: a table."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from orbisim.errors import RecordingError
from orbisim.files.reading import Allowance, size_of
from orbisim.recording.formats import arrow
from orbisim.recording.formats.log import Array, Column, Log
from orbisim.recording.headers import parse_header

KEY = b"orbisim.recording"
"""Where `Recording.save` puts units and metadata."""


class ParquetReader:
    """Reads `.parquet` files; only the columns that are asked for."""

    def read(self, path: Path, part: str = "") -> Log:
        """The columns of a table."""
        size = size_of(path)
        with opened(path) as file:
            schema, rows = file.schema_arrow, file.metadata.num_rows
            text = (schema.metadata or {}).get(KEY)
            columns = tuple(
                Column(field.name, arrow.shape_of(field.type, rows)) for field in schema
            )

        def read(wanted: Sequence[str]) -> Mapping[str, Array]:
            Allowance(path, size).take(8 * rows * len(wanted), f"{len(wanted)} columns")
            with opened(path) as file:
                table = file.read(columns=list(wanted))
                return {n: arrow.to_array(table.column(n), n, str(path)) for n in wanted}

        header = parse_header(path, text) if text else {}
        return Log(str(path), columns, read, table=True, literal=bool(text), header=header)


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Any]:
    """A file of Parquet.

    Raises:
      RecordingError: it is none, or damaged (also where it is read within the context).
    """
    import pyarrow
    import pyarrow.parquet

    try:
        with pyarrow.parquet.ParquetFile(path) as file:
            yield file
    except (pyarrow.ArrowException, OSError, UnicodeDecodeError, KeyError) as error:
        text = " ".join(str(error).split())[:300]
        raise RecordingError(str(path), f"is not a .parquet file: {text}") from None
