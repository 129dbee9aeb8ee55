"""Arrow's columns as NumPy arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from orbisim.errors import RecordingError
from orbisim.recording.formats.log import Array


def shape_of(kind: Any, rows: int) -> tuple[int, ...] | None:
    """Shape of a column of an Arrow type, None if it holds no numbers (or its width is unknown)."""
    import pyarrow.types as types

    if types.is_fixed_size_list(kind):
        return (rows, kind.list_size)
    return (rows,) if is_number(kind) or is_time(kind) else None


def is_number(kind: Any) -> bool:
    """Whether an Arrow type is that of numbers or truth values."""
    import pyarrow.types as types

    return bool(
        types.is_floating(kind)
        or types.is_integer(kind)
        or types.is_boolean(kind)
        or types.is_decimal(kind)
    )


def is_time(kind: Any) -> bool:
    """Whether an Arrow type is that of moments or durations."""
    import pyarrow.types as types

    return bool(types.is_timestamp(kind) or types.is_duration(kind))


def to_array(column: Any, name: str, source: str) -> Array:
    """A column as [T], or [T, n] of lists of equal length; NaN for null.

    Whole numbers without null and times keep all their digits.

    Raises:
      RecordingError: it holds no numbers, or lists of different lengths.
    """
    import pyarrow
    import pyarrow.types as types

    kind = column.type
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        return _of_lists(column, name, source)
    if is_time(kind):
        if column.null_count:
            raise RecordingError(source, "has rows without a time", element=repr(name))
        ticks = column.cast(pyarrow.int64()).to_numpy()
        letter = "M" if types.is_timestamp(kind) else "m"
        return np.asarray(ticks).view(f"{letter}8[{kind.unit}]")
    if not is_number(kind):
        raise RecordingError(
            source,
            f"must hold numbers; got {kind}",
            element=repr(name),
            remedy="time is a number, a timestamp or a duration; vectors have a column for each "
            "component, or lists of equal length",
        )
    if types.is_integer(kind) and not column.null_count:
        return np.asarray(column.to_numpy())
    return np.asarray(column.cast(pyarrow.float64()).to_numpy(), np.float64)


def _of_lists(column: Any, name: str, source: str) -> Array:
    import pyarrow
    import pyarrow.compute as compute

    lengths = compute.list_value_length(column)
    extent = compute.min_max(lengths).as_py()
    width = extent["min"]
    if column.null_count or width is None or width != extent["max"]:
        problem = "must hold lists of equal length, one for each time"
        raise RecordingError(source, problem, element=repr(name))
    flat = compute.list_flatten(column)
    if not is_number(flat.type):
        raise RecordingError(source, f"must hold numbers; got {column.type}", element=repr(name))
    values = np.asarray(flat.cast(pyarrow.float64()).to_numpy(), np.float64)
    return values.reshape(len(column), width)
