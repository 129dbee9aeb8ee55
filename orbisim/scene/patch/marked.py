"""Elements of MJCF files with the bytes that they stand on, includes in their place."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from xml.parsers import expat

from orbisim.errors import SceneError
from orbisim.scene.safety import xmlsafe


@dataclasses.dataclass(eq=False)
class Element:
    """An element of a document.

    Attributes:
      tag, attributes: as they stand there.
      file: the file that it stands in; None in a document without a file.
      start, inner, end: offsets in bytes of its `<`, of what follows its start tag, and of what
        follows the element.
      children: with those of included files in the place of `<include>`.
    """

    tag: str
    attributes: dict[str, str]
    file: Path | None = None
    start: int = 0
    inner: int = 0
    end: int = 0
    children: list[Element] = dataclasses.field(default_factory=list)

    @property
    def name(self) -> str:
        """Its name, or empty."""
        return self.attributes.get("name", "")

    def descendants(self) -> Iterator[Element]:
        """The element itself and everything below it, in document order."""
        yield self
        for child in self.children:
            yield from child.descendants()


def parsed(text: str) -> Element:
    """A document without a file.

    Raises:
      SceneError: it is not safe XML.
    """
    return _tree(text.encode(), None, "document")


def read(path: Path, folder: Path | None = None, depth: int = 0) -> Element:
    """A file with what it includes.

    Args:
      path: of the file. folder: of the main file, from which MuJoCo resolves names.
      depth: of includes around it.

    Raises:
      SceneError: a file is not there, is not safe XML, or includes without end.
    """
    path = path.resolve()
    folder = folder or path.parent
    if depth > _DEPTH:
        raise SceneError(str(path), f"includes are more than {_DEPTH} files deep")
    root = _tree(path.read_bytes(), path, str(path))
    for element in list(root.descendants()):
        element.children = [
            part for child in element.children for part in _included(child, folder, path, depth)
        ]
    return root


_DEPTH = 20
"""Files that include each other; more are a circle."""


def _included(child: Element, folder: Path, path: Path, depth: int) -> list[Element]:
    if child.tag != "include" or child.file != path:
        return [child]
    name = child.attributes.get("file", "")
    for place in (folder / name, path.parent / name):
        if place.is_file():
            return read(place, folder, depth + 1).children
    raise SceneError(str(path), f"the file {name!r} is not there", element="<include>")


def _tree(data: bytes, file: Path | None, source: str) -> Element:
    xmlsafe.parse(data, source)  # refuses what expat alone would take
    top = Element("", {})
    open_elements, words = [top], [""]
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        at = parser.CurrentByteIndex
        element = Element(tag, dict(attributes), file, at, end_of_tag(data, at))
        open_elements[-1].children.append(element)
        open_elements.append(element)
        words.append("")

    def characters(text: str) -> None:
        words[-1] += text

    def end(_: str) -> None:
        element, inside = open_elements.pop(), words.pop().strip()
        if element.tag == "text" and inside:  # MuJoCo writes so what may also stand in `data`
            element.attributes["data"] = inside
        at = parser.CurrentByteIndex
        closes_itself = data[element.inner - 2 : element.inner] == b"/>"
        element.end = element.inner if closes_itself else end_of_tag(data, at)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = characters
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise SceneError(source, f"is not well formed: {error}") from None
    return top.children[0]


def end_of_tag(data: bytes, start: int) -> int:
    """The offset after the `>` of the tag that starts at `start`; quotes may hold others."""
    quote = 0
    for at in range(start, len(data)):
        byte = data[at]
        if quote:
            quote = 0 if byte == quote else quote
        elif byte in b"\"'":
            quote = byte
        elif byte == ord(">"):
            return at + 1
    return len(data)
