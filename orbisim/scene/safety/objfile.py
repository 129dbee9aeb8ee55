"""Wavefront OBJ: what a file holds, found without a parser and without a loop over its lines.

Lines are found and sorted by their first letters with numpy, a few megabytes at a time; numbers of
all lines of a kind are then converted at once. Only where a line is not of the usual form (a
comment, a number that is none) are lines looked at one by one, to say which is to blame.
"""

from __future__ import annotations

import dataclasses
import re
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.scene.safety.problem import MeshProblemError

_CHUNK = 8 * 2**20
"""Bytes that are looked at together: masks over them take several times as much memory."""
_MAX_FLOAT32 = float(np.finfo(np.float32).max)
Bytes = npt.NDArray[np.uint8]


def _table(letters: bytes) -> npt.NDArray[np.bool_]:
    """For each byte, whether it is one of the letters."""
    return np.isin(np.arange(256), list(letters))


_BLANK, _END, _SPACE = _table(b" \t"), _table(b"\r\n"), _table(b" \t\r\n")
_KINDS = {"v": _table(b"v"), "f": _table(b"f"), "object": _table(b"og")}


@dataclasses.dataclass(frozen=True)
class ObjContents:
    """What an OBJ file holds.

    Attributes:
      vertices, faces: how many.
      several_objects: whether an object or group starts after the first face: MuJoCo's decoder
        stops there.
    """

    vertices: int
    faces: int
    several_objects: bool


def obj_contents(data: bytes) -> ObjContents:
    """Counts what a file holds, and looks at every number.

    Raises:
      MeshProblemError: it is no text, a vertex is not three finite numbers, or a face names a
        vertex that does not exist.
    """
    if b"\0" in data:
        raise MeshProblemError("is no OBJ: it holds NUL bytes")
    vertices = faces = 0
    lowest = highest = 0
    several = False
    for chunk in _chunks(data):
        lines = _Lines(chunk)
        vertices += _check_vertices(lines, vertices)
        corners = _corners(lines)
        if corners.size:
            if not corners.all():
                raise MeshProblemError(_no_vertex(0, vertices))
            lowest, highest = min(lowest, int(corners.min())), max(highest, int(corners.max()))
        several = several or lines.objects_after(0 if faces else lines.first("f"))
        faces += len(lines.starts["f"])
    if highest > vertices or lowest < -vertices:
        raise MeshProblemError(_no_vertex(highest if highest > vertices else lowest, vertices))
    return ObjContents(vertices, faces, several)


def obj_vertices(data: bytes) -> npt.NDArray[np.float64]:
    """The vertices [n, 3] of a file that `obj_contents` has looked at."""
    found = [_numbers(lines, 0) for lines in map(_Lines, _chunks(data))]
    return np.concatenate(found) if found else np.zeros((0, 3))


def _no_vertex(number: int, count: int) -> str:
    return f"has a face with vertex {number}; it has vertices 1 to {count}"


def _chunks(data: bytes) -> Iterator[Bytes]:
    """The file in pieces that end with a line."""
    start = 0
    while start < len(data):
        end = min(start + _CHUNK, len(data))
        if end < len(data):
            end = data.find(b"\n", end) + 1 or len(data)
        yield np.frombuffer(data[start:end] + b"\n\n", np.uint8)
        start = end


class _Lines:
    """A piece of a file: where its lines begin, by kind."""

    def __init__(self, text: Bytes) -> None:
        self.text = text
        self.ends = np.flatnonzero(_END[text])
        visible = np.flatnonzero(~_BLANK[text])
        begins = np.concatenate([[0], self.ends[:-1] + 1])
        first = visible[np.searchsorted(visible, begins)]  # its end, where a line is empty
        letter, after = text[first], text[np.minimum(first + 1, len(text) - 1)]
        apart = _BLANK[after]
        self.starts: dict[str, npt.NDArray[np.int64]] = {}
        self._last: dict[str, npt.NDArray[np.int64]] = {}
        for kind, letters in _KINDS.items():
            mine = letters[letter] & (apart | (kind == "object") & _END[after])
            self.starts[kind], self._last[kind] = first[mine] + 1, self.ends[mine]

    def first(self, kind: str) -> int | None:
        """Where the first line of a kind begins."""
        return int(self.starts[kind][0]) if len(self.starts[kind]) else None

    def objects_after(self, place: int | None) -> bool:
        """Whether an object or group begins after a place."""
        return place is not None and bool((self.starts["object"] > place).any())

    def of(self, kind: str) -> Bytes:
        """What stands in the lines of a kind after their letter, each with its end."""
        steps = np.zeros(len(self.text) + 1, np.int8)
        steps[self.starts[kind]] += 1
        steps[self._last[kind] + 1] -= 1
        return self.text[np.cumsum(steps[:-1], dtype=np.int8).astype(bool)]


def _check_vertices(lines: _Lines, before: int) -> int:
    """Looks at the vertices of a piece; returns how many there are."""
    points = _numbers(lines, before)
    finite = (np.abs(points) <= _MAX_FLOAT32).all(axis=1)
    if not finite.all():
        raise MeshProblemError(f"vertex {before + int(np.argmin(finite))} is not finite")
    return len(points)


def _numbers(lines: _Lines, before: int) -> npt.NDArray[np.float64]:
    """The first three numbers of each vertex; `before` of them came in earlier pieces."""
    text, count = lines.of("v"), len(lines.starts["v"])
    if not count:
        return np.zeros((0, 3))
    tokens = _tokens_per_line(text)
    if len(tokens) == count and (tokens == tokens[0]).all() and tokens[0] >= 3:
        values = _converted(text.tobytes(), np.float64)
        if values is not None and values.size == count * tokens[0]:
            return values.reshape(count, -1)[:, :3]
    rows = enumerate(text.tobytes().splitlines())
    return np.array([_vertex(line, before + number) for number, line in rows])


def _tokens_per_line(text: Bytes) -> npt.NDArray[np.int64]:
    visible = ~_SPACE[text]
    begins = visible & ~np.concatenate([[False], visible[:-1]])
    ends = np.flatnonzero(_END[text])
    return np.diff(np.concatenate([[0], np.cumsum(begins)[ends]]))


def _converted(text: bytes, kind: Any) -> npt.NDArray[Any] | None:
    """All numbers of a text; None if something in it is no number."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # numpy's, where it stops early
        try:
            return np.fromstring(text, kind, sep=" ")
        except (DeprecationWarning, ValueError):
            return None


def _vertex(line: bytes, number: int) -> list[float]:
    try:
        xyz = [float(token) for token in line.split(b"#")[0].split()[:3]]
    except ValueError:
        xyz = []
    if len(xyz) < 3:
        shown = line.strip()[:60].decode(errors="replace")
        raise MeshProblemError(f"vertex {number} is {shown!r}; expected three numbers")
    return xyz


def _corners(lines: _Lines) -> npt.NDArray[np.int64]:
    """The vertex numbers of all faces of a piece."""
    text = lines.of("f")
    if not text.size:
        return np.zeros(0, np.int64)
    plain = _without_attributes(text).tobytes()
    if b"#" in plain:
        plain = re.sub(rb"#[^\r\n]*", b"", plain)
    found = _converted(plain, np.int64)
    if found is None:
        raise MeshProblemError("has a face that is not a list of vertex numbers")
    return found


def _without_attributes(text: Bytes) -> Bytes:
    """Corners such as 7/3/7 without what follows the first slash."""
    slash = text == ord("/")
    if not slash.any():
        return text
    place = np.arange(len(text), dtype=np.int32)
    blank = _SPACE[text]
    last_blank = np.maximum.accumulate(np.where(blank, place, 0))
    last_slash = np.maximum.accumulate(np.where(slash, place, -1))
    return text[blank | (last_slash <= last_blank)]
