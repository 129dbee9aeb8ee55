"""`.csv`: a table with headers in its first line."""

from __future__ import annotations

import csv
import dataclasses
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from orbisim.errors import RecordingError
from orbisim.files.reading import size_of
from orbisim.recording.formats import arrow, labels
from orbisim.recording.formats.log import Array, Column, Log

_MISSING = ["", "nan", "NaN", "NAN", "NA", "null", "None"]
_LONGEST_HEADER = 4 * 2**20
"""Bytes of the headers: a hundred thousand names."""


@dataclasses.dataclass(frozen=True)
class _Layout:
    """headers: names of the columns. lines: that they take. comma: what separates columns.
    point: what separates decimals."""

    headers: tuple[str, ...]
    lines: int
    comma: str
    point: str


class CsvReader:
    """Reads tables separated by commas, semicolons or tabs; only the columns that are asked for."""

    def read(self, path: Path, part: str = "") -> Log:
        """The columns of a table."""
        layout = _layout(path)

        def read(wanted: Sequence[str]) -> Mapping[str, Array]:
            return _read(path, layout, list(wanted))

        return Log(str(path), tuple(map(Column, layout.headers)), read, table=True)


def _layout(path: Path) -> _Layout:
    size_of(path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            head = file.read(_LONGEST_HEADER)
    except UnicodeDecodeError as error:
        raise RecordingError(str(path), f"is not a table: {error}") from None
    first = head.partition("\n")[0]
    if len(first) == _LONGEST_HEADER:
        raise RecordingError(str(path), f"its first line is longer than {_LONGEST_HEADER} bytes")
    comma = next((mark for mark in ",;\t" if mark in first), ",")
    try:
        reader = csv.reader(iter(head.splitlines(keepends=True)), delimiter=comma)
        headers: list[str] = next(reader, [])
        lines = reader.line_num
        second = next(reader, [])
    except csv.Error as error:
        raise RecordingError(str(path), f"is not a table: {error}") from None
    point = "," if comma != "," and any("," in cell for cell in second) else "."
    return _Layout(tuple(headers), lines, comma, point)


def _read(path: Path, layout: _Layout, wanted: list[str]) -> Mapping[str, Array]:
    import pyarrow
    import pyarrow.csv

    count = Counter(layout.headers)
    if twice := [name for name in wanted if count[name] > 1]:
        raise RecordingError(str(path), f"{twice[0]!r} stands in two columns; rename one of them")
    timeless = [name for name in wanted if not labels.is_time(labels.parse(name).name)]
    options = pyarrow.csv.ConvertOptions(
        include_columns=wanted,
        column_types=dict.fromkeys(timeless, pyarrow.float64()),
        null_values=_MISSING,
        decimal_point=layout.point,
    )
    parse = pyarrow.csv.ParseOptions(delimiter=layout.comma, newlines_in_values=False)
    rows = pyarrow.csv.ReadOptions(skip_rows=layout.lines, column_names=list(layout.headers))
    try:
        table = pyarrow.csv.read_csv(
            path, read_options=rows, parse_options=parse, convert_options=options
        )
    except (pyarrow.ArrowException, UnicodeDecodeError, OSError) as error:
        text = _with_name(" ".join(str(error).split())[:300], layout.headers)
        raise RecordingError(str(path), f"is not a table of numbers: {text}") from None
    return {name: _array(table.column(name), name, str(path)) for name in wanted}


def _array(column: Any, name: str, source: str) -> Array:
    import pyarrow
    import pyarrow.types as types

    if types.is_null(column.type):  # a time column without rows, or of empty cells
        column = column.cast(pyarrow.float64())
    return arrow.to_array(column, name, source)


def _with_name(text: str, headers: Sequence[str]) -> str:
    """Arrow's message with the column's name instead of its number."""

    def named(match: re.Match[str]) -> str:
        number = int(match[1])
        return f"column {headers[number]!r}" if number < len(headers) else match[0]

    return re.sub(r"(?:In )?CSV column #(\d+)", named, text)
