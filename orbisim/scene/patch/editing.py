"""Carries differences over into the bytes of the user's files."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

from orbisim.errors import SceneError
from orbisim.scene.patch.differences import Change, Insertion, matched
from orbisim.scene.patch.marked import Element

ORIENTATIONS = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
"""Attributes of which an element has one."""
_OF_ACTUATORS = frozenset(
    ("ctrlrange", "ctrllimited", "forcerange", "forcelimited", "actrange", "actlimited", "gear",
     "delay", "nsample", "interp", "name", "class")
)  # fmt: skip
"""Attributes that mean the same in every element of <actuator>."""
_ANGLES = ("range", "ref", "springref")
"""Attributes of hinges and balls that are angles."""


@dataclasses.dataclass(frozen=True)
class Edit:
    """Bytes of a file that become others."""

    file: Path
    start: int
    end: int
    text: bytes


class Counterparts:
    """What stands for an element, as MuJoCo writes it, in the user's files.

    Args:
      written: the document as MuJoCo writes it. own: the user's, with its includes.
    """

    def __init__(self, written: Element, own: Element) -> None:
        self.root = own
        self._of = {id(written): own}
        self._sections: dict[str, list[Element]] = {}
        for section in own.children:
            self._sections.setdefault(section.tag, []).append(section)
        for section in written.children:
            mine = self._sections.get(section.tag)
            if not mine or section.tag == "default":
                continue
            # of sections written several times, the last word counts
            self._of[id(section)] = mine[-1]
            self._pair(section, [child for one in mine for child in one.children])

    def _pair(self, written: Element, children: Iterable[Element]) -> None:
        mine = _plain(children)
        theirs = _plain(written.children)
        for theirs_one, my_one in matched(theirs, mine, written.tag):
            self._of[id(theirs_one)] = my_one
            self._pair(theirs_one, my_one.children)

    def find(self, element: Element) -> Element | None:
        """The element in the user's files; None if it stands nowhere (it was made by another)."""
        return self._of.get(id(element))


def _plain(children: Iterable[Element]) -> list[Element]:
    """Children, with those of frames in their place."""
    found: list[Element] = []
    for child in children:
        found += _plain(child.children) if child.tag == "frame" else [child]
    return found


def edits(
    changes: Iterable[Change | Insertion],
    counterparts: Counterparts,
    turning: frozenset[int],
    degrees: bool,
) -> Iterator[Edit]:
    """The edits that make the changes.

    Args:
      turning: identities (`id`) of the joints that turn, in the changed document.
      degrees: whether the user's files have angles in degrees.

    Raises:
      SceneError: something to change does not stand in the user's files.
    """
    texts: dict[Path, bytes] = {}
    sections: dict[str, list[Element]] = {}
    for change in changes:
        if isinstance(change, Insertion) and counterparts.find(change.parent) is None:
            sections.setdefault(change.parent.tag, []).append(change.element)
            continue
        if isinstance(change, Insertion) and change.parent.tag != "mujoco":
            yield _inserted(change, counterparts, texts, turning, degrees)
        elif isinstance(change, Insertion):
            yield _appended(change.element, counterparts.root, texts, turning, degrees)
        else:
            yield _changed(change, counterparts, texts, turning, degrees)
    for tag, elements in sections.items():
        whole = Element(tag, {}, children=elements)
        yield _appended(whole, counterparts.root, texts, turning, degrees)


def _bytes(file: Path, texts: dict[Path, bytes]) -> bytes:
    if file not in texts:
        texts[file] = file.read_bytes()
    return texts[file]


def _place(element: Element | None, wanted: Element) -> tuple[Element, Path]:
    if element is None or element.file is None:
        label = f"<{wanted.tag}> {wanted.name!r}" if wanted.name else f"<{wanted.tag}>"
        raise SceneError("", f"{label} does not stand in the file: another element makes it")
    return element, element.file


def _changed(
    change: Change,
    counterparts: Counterparts,
    texts: dict[Path, bytes],
    turning: frozenset[int],
    degrees: bool,
) -> Edit:
    mine, file = _place(counterparts.find(change.before), change.before)
    data = _bytes(file, texts)
    tag = data[mine.start : mine.inner].decode()
    new = dict(change.attributes)
    of_shortcut = mine.tag != change.before.tag and mine.tag not in ("joint", "freejoint")
    if (of_shortcut and not _OF_ACTUATORS.issuperset(new)) or mine.tag == "inertial":
        own = {k: v for k, v in change.after.attributes.items() if k != "class"}
        if "class" in mine.attributes:
            own["class"] = mine.attributes["class"]
        text = _start_tag(Element(change.after.tag, own), _attributes(own, False))
        if tag.endswith("/>"):
            return Edit(file, mine.start, mine.inner, f"{text}/>".encode())
        raise SceneError("", f"<{mine.tag}> {mine.name!r} is not one tag")
    if "quat" in new:
        new |= {name: None for name in ORIENTATIONS if name in mine.attributes and name != "quat"}
    shown = _attributes(
        {k: v for k, v in new.items() if v is not None}, degrees and id(change.after) in turning
    )
    for name, value in new.items():
        tag = _without(tag, name) if value is None else _with(tag, name, shown[name])
    return Edit(file, mine.start, mine.inner, tag.encode())


def _with(tag: str, name: str, value: str) -> str:
    """A start tag with an attribute, in the place of the old one or at its end."""
    quoted = quoteattr(value)
    found = _attribute(name).search(tag)
    if found:
        return f"{tag[: found.start()]}{found['space']}{name}={quoted}{tag[found.end() :]}"
    end = re.search(r"\s*/?>$", tag)
    assert end is not None
    return f"{tag[: end.start()]} {name}={quoted}{tag[end.start() :]}"


def _without(tag: str, name: str) -> str:
    return _attribute(name).sub("", tag)


def _attribute(name: str) -> re.Pattern[str]:
    return re.compile(rf"(?P<space>\s+){re.escape(name)}\s*=\s*(\"[^\"]*\"|'[^']*')")


def _attributes(attributes: Mapping[str, str], degrees: bool) -> dict[str, str]:
    """Attributes with numbers of at most `_DIGITS` digits, angles as the file has them."""
    return {
        name: _numbers(value, 180 / math.pi if degrees and name in _ANGLES else 1.0)
        for name, value in attributes.items()
    }


def _numbers(value: str, factor: float) -> str:
    words = value.split()
    if factor == 1.0 and max(map(len, words), default=0) < _LONG:
        return value
    if not all(map(_NUMBER.fullmatch, words)):
        return value
    numbers = [float(word) * factor for word in words]
    return " ".join(f"{x:.{_DIGITS}g}" for x in numbers)


_NUMBER = re.compile(r"-?\d+(\.\d*)?(e[-+]?\d+)?")
_DIGITS = 10
"""Digits of a number: a tenth of what the patched model may differ by is lost, and what a fit gave
beyond them is noise to whoever reads the patch."""
_LONG = 10
"""Characters of a number that MuJoCo wrote with all its digits."""


def _inserted(
    insertion: Insertion,
    counterparts: Counterparts,
    texts: dict[Path, bytes],
    turning: frozenset[int],
    degrees: bool,
) -> Edit:
    previous = insertion.previous and counterparts.find(insertion.previous)
    if previous is not None and previous.file is not None:
        data = _bytes(previous.file, texts)
        indent = _indent(data, previous.start)
        text = _lines(insertion.element, indent, turning, degrees)
        return Edit(previous.file, previous.end, previous.end, f"\n{text}".encode())
    parent, file = _place(counterparts.find(insertion.parent), insertion.parent)
    data = _bytes(file, texts)
    indent = _indent(data, parent.start)
    text = _lines(insertion.element, f"{indent}  ", turning, degrees)
    if data[parent.inner - 2 : parent.inner] == b"/>":
        opened = f">\n{text}\n{indent}</{parent.tag}>"
        return Edit(file, parent.inner - 2, parent.inner, opened.encode())
    return Edit(file, parent.inner, parent.inner, f"\n{text}".encode())


def _appended(
    element: Element,
    root: Element,
    texts: dict[Path, bytes],
    turning: frozenset[int],
    degrees: bool,
) -> Edit:
    """A new section before the end of the main file."""
    root, file = _place(root, root)
    data = _bytes(file, texts)
    if data[root.inner - 2 : root.inner] == b"/>":
        raise SceneError("", "<mujoco/> is empty")
    closing = data.rindex(b"</", root.start, root.end)
    line = data.rfind(b"\n", 0, closing) + 1
    clear = not data[line:closing].strip()
    text = _lines(element, "  ", turning, degrees)
    at = line if clear else closing
    return Edit(file, at, at, f"{text}\n".encode() if clear else f"\n{text}\n".encode())


def _lines(element: Element, indent: str, turning: frozenset[int], degrees: bool) -> str:
    attributes = _attributes(element.attributes, degrees and id(element) in turning)
    start = indent + _start_tag(element, attributes)
    if not element.children:
        return f"{start}/>"
    inner = [_lines(child, f"{indent}  ", turning, degrees) for child in element.children]
    return "\n".join([f"{start}>", *inner, f"{indent}</{element.tag}>"])


def _start_tag(element: Element, attributes: Mapping[str, str]) -> str:
    parts = [f"{escape(name)}={quoteattr(value)}" for name, value in attributes.items()]
    return " ".join([f"<{element.tag}", *parts])


def _indent(data: bytes, start: int) -> str:
    """The white space before an element on its line; of one behind others, that of the line."""
    line = data.rfind(b"\n", 0, start) + 1
    found = re.match(rb"[ \t]*", data[line:start])
    return found[0].decode() if found else ""


def applied(found: Iterable[Edit]) -> dict[Path, tuple[bytes, bytes]]:
    """Files that change, before and after."""
    of_file: dict[Path, list[Edit]] = {}
    for edit in found:
        of_file.setdefault(edit.file, []).append(edit)
    result = {}
    for file, mine in of_file.items():
        data = before = file.read_bytes()
        number = {id(edit): i for i, edit in enumerate(mine)}
        for edit in sorted(mine, key=lambda e: (e.start, e.end, number[id(e)]), reverse=True):
            data = data[: edit.start] + edit.text + data[edit.end :]
        result[file] = (before, _line_ends(data, before))
    return result


def _line_ends(data: bytes, before: bytes) -> bytes:
    """With the line ends of the file: all new lines are written with a line feed alone."""
    if b"\r\n" not in before or b"\n" in before.replace(b"\r\n", b""):
        return data
    return data.replace(b"\r\n", b"\n").replace(b"\n", b"\r\n")
