"""`.h5`, `.hdf5`: arrays in groups.

Each dataset of numbers [T] or [T, n] is a column, named by its place; its attribute `units` or
`unit` is its unit. Datasets of one group belong together: the group's own time, or that of the
nearest group above, is theirs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from orbisim.errors import InputError, RecordingError
from orbisim.files.hdf5 import Reader, try_out
from orbisim.recording.formats.log import Array, Column, Log

_UNITS = ("units", "unit")
_SECONDS = 1.0
"""Of the processor, and one more for each megabyte: a hundred times what a sound file takes."""


class Hdf5Reader:
    """Reads HDF5 files. Links to elsewhere, virtual datasets and unknown filters are refused."""

    def read(self, path: Path, part: str = "") -> Log:
        """The datasets of a file."""

        def columns() -> tuple[Column, ...]:
            with Reader(path) as file:
                return tuple(_columns(file))

        def read(wanted: Sequence[str]) -> Mapping[str, Array]:
            with Reader(path) as file:
                allowance = file.allowance()
                return {name: file.array(name, allowance) for name in wanted}

        def tried(wanted: Sequence[str]) -> Mapping[str, Array]:
            _try(path, lambda: read(wanted))
            return read(wanted)

        _try(path, columns)
        return Log(str(path), columns(), tried)


def _try(path: Path, work: Callable[[], object]) -> None:
    try:
        try_out(path, work, _SECONDS)
    except InputError as error:
        raise RecordingError(str(path), str(error).removeprefix(f"{path}: ")) from None


def _columns(file: Reader) -> Iterator[Column]:
    for place in file.datasets():
        shape = file.shape(place)
        if len(shape) in (1, 2):
            yield Column(place, shape, _unit(file, place), group=place.rpartition("/")[0])


def _unit(file: Reader, place: str) -> str | None:
    for name in _UNITS:
        try:
            value = file.attribute(place, name)
        except InputError:  # an array, say: no unit
            continue
        if isinstance(value, str):
            return value
    return None
