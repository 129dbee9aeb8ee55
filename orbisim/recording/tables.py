"""Recordings as tables: `.csv` and `.parquet`."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.errors import RecordingError
from orbisim.recording import names
from orbisim.recording.contents import Contents
from orbisim.recording.headers import assemble, header_of, parse_header

_PARQUET_KEY = b"orbisim.recording"
_MISSING = ["", "nan", "NaN", "NAN", "NA", "null", "None"]


def _columns_of(recording: Contents) -> dict[str, npt.NDArray[np.float64]]:
    table = {"time": recording.time}
    for name, values in recording.signals.items():
        width = None if values.ndim == 1 else values.shape[1]
        parts = [values] if width is None else list(values.T)
        table |= dict(zip(names.columns(name, width), parts, strict=True))
    return table


def _from_columns(
    path: Path,
    headers: list[str],
    read: Callable[[list[str]], Mapping[str, npt.NDArray[np.float64]]],
    header: Mapping[str, Any],
) -> Contents:
    """Assembles the signals of a table; `read` returns the wanted columns."""
    repeated = sorted({name for name in headers if headers.count(name) > 1})
    if repeated:
        raise RecordingError(str(path), "stands in two columns", element=repr(repeated[0]))
    try:
        groups = names.gather(headers)
    except ValueError as error:
        raise RecordingError(str(path), str(error)) from None
    used = [column for group in groups.values() for column in group]
    if "time" in headers:
        used.insert(0, "time")
    columns = read(used)
    arrays: dict[str, npt.ArrayLike] = {}
    if "time" in columns:
        arrays["time"] = columns["time"]
    for name, group in groups.items():
        whole = len(group) > 1 or name in names.WHOLE
        arrays[name] = np.stack([columns[c] for c in group], 1) if whole else columns[group[0]]
    return assemble(path, arrays, header, [name for name in headers if name not in used])


def load_csv(path: Path) -> Contents:
    """Reads a table with the names of `orbisim.recording.names` in its first line."""
    import pyarrow
    import pyarrow.csv

    headers = _csv_headers(path)

    def read(wanted: list[str]) -> dict[str, npt.NDArray[np.float64]]:
        options = pyarrow.csv.ConvertOptions(
            include_columns=wanted,
            column_types=dict.fromkeys(wanted, pyarrow.float64()),
            null_values=_MISSING,
        )
        parse = pyarrow.csv.ParseOptions(newlines_in_values=False)
        rows = pyarrow.csv.ReadOptions(skip_rows=_header_lines(path), column_names=headers)
        try:
            table = pyarrow.csv.read_csv(
                path, read_options=rows, parse_options=parse, convert_options=options
            )
        except (pyarrow.ArrowInvalid, UnicodeDecodeError) as error:
            text = _with_name(" ".join(str(error).split())[:300], headers)
            raise RecordingError(str(path), f"is not a table of numbers: {text}") from None
        return {name: _to_floats(table, name) for name in wanted}

    return _from_columns(path, headers, read, {})


def _with_name(text: str, headers: list[str]) -> str:
    """Arrow's message with the column's name instead of its number."""

    def named(match: re.Match[str]) -> str:
        number = int(match[1])
        return f"column {headers[number]!r}" if number < len(headers) else match[0]

    return re.sub(r"(?:In )?CSV column #(\d+)", named, text)


def _csv_rows(path: Path) -> Any:
    """The csv reader at the start of the file, and the file."""
    file = path.open(newline="", encoding="utf-8-sig")
    return csv.reader(file), file


def _csv_headers(path: Path) -> list[str]:
    reader, file = _csv_rows(path)
    with file:
        try:
            headers: list[str] = next(reader, [])
        except (UnicodeDecodeError, csv.Error) as error:
            raise RecordingError(str(path), f"is not a table: {error}") from None
    if len(headers) == 1 and any(mark in headers[0] for mark in ";\t"):
        raise RecordingError(
            str(path), "its columns are not separated by commas", remedy="write it with commas"
        )
    return headers


def _header_lines(path: Path) -> int:
    """Lines that the headers take (names in quotes may hold line ends)."""
    reader, file = _csv_rows(path)
    with file:
        next(reader, None)
        return int(reader.line_num)


def save_csv(recording: Contents, path: Path) -> None:
    """Writes a table; numbers keep all their digits."""
    import pyarrow
    import pyarrow.csv

    columns = _columns_of(recording)
    header = io.StringIO(newline="")
    csv.writer(header, quoting=csv.QUOTE_MINIMAL, lineterminator="\n").writerow(columns)
    table = pyarrow.table([pyarrow.array(c) for c in columns.values()], names=list(columns))
    with path.open("wb") as file:
        file.write(header.getvalue().encode())
        options = pyarrow.csv.WriteOptions(include_header=False)
        pyarrow.csv.write_csv(table, file, options)


def load_parquet(path: Path) -> Contents:
    """Reads a table with the names of `orbisim.recording.names`, and the header if it has one."""
    import pyarrow
    import pyarrow.parquet

    try:
        file = pyarrow.parquet.ParquetFile(path)
        schema = file.schema_arrow
        text = (schema.metadata or {}).get(_PARQUET_KEY)
        header = parse_header(path, text) if text else {}

        def read(wanted: list[str]) -> dict[str, npt.NDArray[np.float64]]:
            for name in wanted:
                _check_numeric(path, name, schema.field(name).type)
            table = file.read(columns=wanted)
            return {name: _to_floats(table, name) for name in wanted}

        return _from_columns(path, list(schema.names), read, header)
    except (pyarrow.ArrowException, OSError, UnicodeDecodeError) as error:
        text = " ".join(str(error).split())[:300]
        raise RecordingError(str(path), f"is not a .parquet file: {text}") from None


def _check_numeric(path: Path, name: str, kind: Any) -> None:
    import pyarrow.types as types

    if not (types.is_floating(kind) or types.is_integer(kind) or types.is_boolean(kind)):
        raise RecordingError(
            str(path),
            f"must hold numbers; got {kind}",
            element=repr(name),
            remedy="time is in seconds, vectors have a column for each component",
        )


def save_parquet(recording: Contents, path: Path) -> None:
    """Writes a table, units and metadata in its own metadata."""
    import pyarrow
    import pyarrow.parquet

    columns = _columns_of(recording)
    table = pyarrow.table([pyarrow.array(c) for c in columns.values()], names=list(columns))
    header = {_PARQUET_KEY: header_of(recording).encode()}
    pyarrow.parquet.write_table(table.replace_schema_metadata(header), path)


def _to_floats(table: Any, name: str) -> npt.NDArray[np.float64]:
    """A column with NaN for null."""
    import pyarrow

    column = table.column(name).cast(pyarrow.float64())
    return np.asarray(column.to_numpy(), np.float64)
