"""`.h5`, `.hdf5`: arrays in groups.

Each dataset of numbers [T] or [T, n] is a column, named by its place; its attribute `units` or
`unit` is its unit. Datasets of one group belong together: the group's own time, or that of the
nearest group above, is theirs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from orbisim.errors import InputError
from orbisim.files.hdf5 import Reader
from orbisim.recording.formats.log import Array, Column, Log

_UNITS = ("units", "unit")


class Hdf5Reader:
    """Reads HDF5 files. Links to elsewhere, virtual datasets and unknown filters are refused."""

    def read(self, path: Path, part: str = "") -> Log:
        """The datasets of a file."""
        with Reader(path) as file:
            columns = tuple(_columns(file))

        def read(wanted: Sequence[str]) -> Mapping[str, Array]:
            with Reader(path) as file:
                allowance = file.allowance()
                return {name: file.array(name, allowance) for name in wanted}

        return Log(str(path), columns, read)


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
