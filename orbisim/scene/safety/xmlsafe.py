"""XML from strangers: parsed without entities, without the network, within bounds.

`parse` builds a tree of `Node`, each of which knows its line. Names keep their prefix
(`sensor:camera`), declared or not: scene files in the wild use prefixes without declaring them.
"""

from __future__ import annotations

import dataclasses
import re
import xml.sax
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree
from xml.sax.handler import ContentHandler

from defusedxml.common import DefusedXmlException  # type: ignore[import-untyped]

from orbisim.errors import SceneError


@dataclasses.dataclass(frozen=True)
class XmlLimits:
    """Bounds on one document.

    Attributes:
      nbytes: size of the document.
      elements: number of elements.
      depth: how deep they are nested.
    """

    nbytes: int = 64 * 2**20
    elements: int = 100_000
    depth: int = 200


_MOST_NAME = 80
"""Characters of a tag or name in a message: a line that can be read."""


class Node(ElementTree.Element):
    """An element that knows the line on which it starts."""

    line: int = 0

    def label(self) -> str:
        """Tag, name and line, for messages."""
        tag, name = self.tag[:_MOST_NAME], self.get("name", "")[:_MOST_NAME]
        named = f"{tag} {name!r}" if name else f"<{tag}>"
        return f"{named} (line {self.line})"

    def nodes(self) -> list[Node]:
        """All direct children."""
        return [child for child in self if isinstance(child, Node)]

    def children(self, tag: str) -> list[Node]:
        """The direct children with a tag."""
        return [child for child in self.nodes() if child.tag == tag]

    def child(self, tag: str) -> Node | None:
        """The first direct child with a tag."""
        return next(iter(self.children(tag)), None)

    def descendants(self) -> Iterator[Node]:
        """The node itself and everything below it, in document order."""
        return (node for node in self.iter() if isinstance(node, Node))


def parse(data: bytes | str, source: str, limits: XmlLimits | None = None) -> Node:
    """Parses a document.

    Args:
      data: the document; bytes are decoded as they declare themselves, UTF-8 otherwise.
      source: named in errors.
      limits: bounds on the document.

    Raises:
      SceneError: the document is not XML text, is not well formed, declares entities, refers to
        external ones, or exceeds the limits.
    """
    import defusedxml.sax  # type: ignore[import-untyped]  # it imports an HTTP client

    limits = limits or XmlLimits()
    raw = _as_utf8(data, source, limits)
    builder = _Builder(source, limits)
    try:
        defusedxml.sax.parseString(raw, builder)
    except DefusedXmlException as error:
        raise SceneError(
            source,
            f"the document declares or refers to entities ({type(error).__name__})",
            remedy="write their content out and remove the declarations",
        ) from None
    except xml.sax.SAXParseException as error:
        raise _not_well_formed(error, raw, source) from None
    except SceneError:
        raise
    except (LookupError, ValueError) as error:  # an encoding that is not known, or is multi-byte
        raise SceneError(source, f"cannot be decoded: {error}", remedy="save it as UTF-8") from None
    assert builder.root is not None  # a document without root is not well formed
    return builder.root


_DECLARATION = re.compile(rb"^\s*<\?xml[^>]*?encoding\s*=\s*[\"']([A-Za-z0-9._-]+)[\"']")
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_UTF8_MARK = b"\xef\xbb\xbf"
_HEAD = 512
"""Bytes in which an XML declaration must stand, if there is one."""


def _as_utf8(data: bytes | str, source: str, limits: XmlLimits) -> bytes:
    """The document as bytes that expat decodes on its own."""
    if len(data) > limits.nbytes:
        raise SceneError(
            source,
            f"the document has {len(data)} bytes; at most {limits.nbytes} are read",
            remedy="move meshes into files of their own",
        )
    if isinstance(data, str):
        text = re.sub(r"^\ufeff?\s*<\?xml[^>]*\?>", "", data)  # it declares what is gone now
        return text.lstrip().encode("utf-8", errors="surrogatepass")
    if not data.strip():
        raise SceneError(source, "the document is empty")
    if data[:2] in _UTF16_MARKS:
        return data
    data = data.removeprefix(_UTF8_MARK).lstrip()  # a declaration after blanks is let pass
    if data.strip(b"\0"):
        data = data.rstrip(b"\0")  # so is the end of a C string
    zero = data.find(b"\0")
    if zero >= 0:
        raise SceneError(
            source, f"is not a text file: byte {zero} is NUL", remedy="name an XML document"
        )
    return _checked_utf8(data, source)


def _checked_utf8(data: bytes, source: str) -> bytes:
    if _DECLARATION.search(data[:_HEAD]):
        return data
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise SceneError(
            source,
            f"line {line}: byte 0x{data[error.start]:02x} is not UTF-8 text",
            remedy='save it as UTF-8, or declare its encoding (<?xml version="1.0" encoding=...?>)',
        ) from None
    return data


def _not_well_formed(error: xml.sax.SAXParseException, raw: bytes, source: str) -> SceneError:
    remedy = "repair the document"
    if not raw.startswith((b"<", *_UTF16_MARKS)):
        remedy = "an XML document starts with '<'"
    return SceneError(
        source,
        f"is not well-formed XML: line {error.getLineNumber()}, column "
        f"{(error.getColumnNumber() or 0) + 1}: {error.getMessage()}",
        remedy=remedy,
    )


def without_comments(data: bytes) -> bytes:
    """The document with comments replaced by the line ends in them.

    Takes time in proportion to its length, which a regular expression does not where comments
    are not closed. What follows a comment that is not closed is gone.
    """
    parts, position = [], 0
    while (start := data.find(b"<!--", position)) >= 0:
        end = data.find(b"-->", start + 4)
        stop = len(data) if end < 0 else end + 3
        parts += [data[position:start], b"\n" * data.count(b"\n", start, stop)]
        position = stop
    return b"".join((*parts, data[position:]))


class _Builder(ContentHandler):
    """Builds the tree and counts."""

    def __init__(self, source: str, limits: XmlLimits) -> None:
        super().__init__()
        self.root: Node | None = None
        self._source, self._limits = source, limits
        self._open: list[Node] = []
        self._text: list[str] = []
        self._count = 0
        self._locator: Any = None

    def setDocumentLocator(self, locator: Any) -> None:
        self._locator = locator

    def startElement(self, name: str, attrs: Any) -> None:
        node = Node(name, dict(attrs.items()))
        node.line = self._locator.getLineNumber()
        self._count += 1
        self._check(node)
        if self._open:
            self._open[-1].append(node)
        else:
            self.root = node
        self._open.append(node)
        self._text.clear()

    def endElement(self, name: str) -> None:
        node = self._open.pop()
        if self._text and not len(node):  # beside children, text carries nothing in a scene
            node.text = "".join(self._text)
        self._text.clear()

    def characters(self, content: str) -> None:
        self._text.append(content)

    def _check(self, node: Node) -> None:
        if self._count > self._limits.elements:
            problem = f"has more than {self._limits.elements} elements"
        elif len(self._open) >= self._limits.depth:
            problem = f"elements are nested more than {self._limits.depth} deep"
        else:
            return
        raise SceneError(self._source, problem, element=node.label())
