"""`.npz`: one array for each signal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from orbisim.files import npz
from orbisim.recording.formats.log import Array, Column, Log
from orbisim.recording.headers import SCHEMA, parse_header

HEADER = "header"


class NpzReader:
    """Reads `.npz` files; arrays are unpacked only if they are asked for."""

    def read(self, path: Path, part: str = "") -> Log:
        """The arrays of a file."""
        with npz.opened(path) as file:
            text = file.get(HEADER)
            own = text is not None and text.dtype.kind == "U" and SCHEMA in str(text)
            names = [name for name in file if not (own and name == HEADER)]

        def read(wanted: Sequence[str]) -> Mapping[str, Array]:
            with npz.opened(path) as file:
                return {name: file[name] for name in wanted}

        return Log(
            source=str(path),
            columns=tuple(map(Column, names)),
            read=read,
            literal=own,
            header=parse_header(path, str(text)) if own else {},
        )
