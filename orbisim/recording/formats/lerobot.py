"""Folders of LeRobot datasets, version 2 and 3.

`meta/info.json` names the features; `data/chunk-*/episode_*.parquet` (version 2: a file for each
episode) or `data/chunk-*/file-*.parquet` (version 3: several episodes in a file) hold them, with
`timestamp` in seconds. Camera images are not read. LeRobot states no units, and what
`observation.state` and `action` are differs from robot to robot: a map says it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from orbisim.errors import InputError, RecordingError
from orbisim.files.reading import Allowance, read_json, size_of
from orbisim.recording.formats import arrow
from orbisim.recording.formats.log import Array, Column, Log
from orbisim.recording.formats.parquet import opened

MARKER = "meta/info.json"
_NUMBERS = re.compile(r"(float|int|uint)\d+")
_OWN = ("timestamp", "frame_index", "episode_index", "index", "task_index")
"""Features that every dataset has, and that measure nothing."""
_MOST = 10_000
"""Components of a feature."""
_MOST_INFO = 16 * 2**20
"""Bytes of the description of a dataset; those of version 2 and 3 have some kilobytes."""


class LeRobotReader:
    """Reads one episode of a dataset: `folder#3`, or the only one."""

    def read(self, path: Path, part: str = "") -> Log:
        """The features of an episode."""
        info = _info(path)
        number = _episode(path, info, part)
        file, rows = _rows(path, number)
        columns, places = _columns(path, info)

        def read(wanted: Sequence[str]) -> Mapping[str, Array]:
            features = list(dict.fromkeys(places[name][0] for name in wanted))
            arrays = _read(path, file, rows, features)
            return {name: _part(arrays[places[name][0]], places[name][1], name, path)
                    for name in wanted}  # fmt: skip

        return Log(f"{path}#{number}" if part else str(path), columns, read)

    def count(self, path: Path) -> int:
        """How many episodes the dataset has."""
        return _count(path, _info(path))


def _info(path: Path) -> Mapping[str, Any]:
    try:
        info: Mapping[str, Any] = read_json(path / MARKER, _MOST_INFO)
    except InputError as error:
        raise RecordingError(str(path), str(error).removeprefix(f"{path}/")) from None
    return info


def _count(path: Path, info: Mapping[str, Any]) -> int:
    """How many episodes there are."""
    count = info.get("total_episodes")
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        raise RecordingError(
            str(path), f"{MARKER}: total_episodes must be a number above 0; got {str(count)[:40]!r}"
        )
    return count


def _episode(path: Path, info: Mapping[str, Any], part: str) -> int:
    """Number of the episode that is meant."""
    count = _count(path, info)
    if not part and count > 1:
        raise RecordingError(
            str(path),
            f"holds {count} episodes, and a recording is one",
            remedy=f"name it: '{path}#0' to '{path}#{count - 1}'",
        )
    if part and not (part.isdecimal() and len(part) < 10 and int(part) < count):
        raise RecordingError(str(path), f"has no episode {part[:40]!r}; it has 0 to {count - 1}")
    return int(part or 0)


def _rows(path: Path, number: int) -> tuple[Path, tuple[int, int] | None]:
    """The file of an episode and its rows in it; None: all of them."""
    alone = sorted(path.glob(f"data/chunk-*/episode_{number:06d}.parquet"))
    if alone:
        return alone[0], None
    for file in sorted(path.glob("data/chunk-*/file-*.parquet")):
        with opened(file) as table:
            if "episode_index" not in table.schema_arrow.names:
                raise RecordingError(str(file), "has no column 'episode_index'")
            _allow(file, table.metadata.num_rows, 1)
            column = table.read(columns=["episode_index"]).column(0)
            mine = np.flatnonzero(arrow.to_array(column, "episode_index", str(file)) == number)
        if mine.size:
            return file, (int(mine[0]), int(mine[-1]) + 1)
    raise RecordingError(str(path), f"has no data of episode {number}")


def _allow(file: Path, rows: int, columns: int) -> None:
    Allowance(file, size_of(file)).take(8 * rows * columns, f"{columns} columns")


def _columns(
    path: Path, info: Mapping[str, Any]
) -> tuple[tuple[Column, ...], dict[str, tuple[str, int | None]]]:
    """The columns, and of each its feature and component."""
    features = info.get("features")
    if not isinstance(features, Mapping):
        raise RecordingError(str(path), f"{MARKER}: 'features' must be an object")
    columns = [Column("timestamp", unit="s")]
    places: dict[str, tuple[str, int | None]] = {"timestamp": ("timestamp", None)}
    for name, feature in features.items():
        if name in _OWN or not _is_numeric(feature):
            continue
        for column, component in _components(path, name, feature):
            if column in places:
                raise RecordingError(str(path), f"{MARKER}: has {column[:200]!r} twice")
            columns.append(Column(column))
            places[column] = (name, component)
    return tuple(columns), places


def _is_numeric(feature: Any) -> bool:
    return isinstance(feature, Mapping) and bool(_NUMBERS.fullmatch(str(feature.get("dtype"))[:20]))


def _components(
    path: Path, name: str, feature: Mapping[str, Any]
) -> Iterator[tuple[str, int | None]]:
    """Names of the components of a feature, and their numbers."""
    shape = feature.get("shape")
    if not (isinstance(shape, Sequence) and len(shape) == 1 and isinstance(shape[0], int)):
        return  # a tensor: an image, say
    width = int(shape[0])
    if not 0 < width <= _MOST:
        raise RecordingError(str(path), f"{MARKER}: {name[:200]!r} has the shape [{width}]")
    given = feature.get("names")
    if isinstance(given, Mapping) and len(given) == 1:  # {"motors": [...]}
        given = next(iter(given.values()))
    if isinstance(given, Mapping):  # {"x": 0, "y": 1}
        given = list(given)
    if isinstance(given, list) and len(given) == width and all(isinstance(n, str) for n in given):
        yield from ((f"{name}/{part}", index) for index, part in enumerate(given))
    else:
        yield from ((f"{name}[{index}]", index) for index in range(width))


def _read(
    path: Path, file: Path, rows: tuple[int, int] | None, features: list[str]
) -> dict[str, Array]:
    with opened(file) as table:
        schema = table.schema_arrow
        missing = [name for name in features if name not in schema.names]
        if missing:
            known = ", ".join(schema.names[:20])
            raise RecordingError(str(file), f"has no column {missing[0]!r}; it has {known}")
        _allow(file, table.metadata.num_rows, len(features))
        found = table.read(columns=features)
        if rows is not None:
            found = found.slice(rows[0], rows[1] - rows[0])
        return {name: arrow.to_array(found.column(name), name, str(file)) for name in features}


def _part(values: Array, component: int | None, name: str, path: Path) -> Array:
    if component is None or (values.ndim == 1 and component == 0):
        return values
    if values.ndim != 2 or component >= values.shape[1]:
        raise RecordingError(
            str(path), f"has the shape {values.shape} in the data", element=repr(name[:200])
        )
    return values[:, component]
