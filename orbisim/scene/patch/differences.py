"""What one document has that another has not, both as MuJoCo writes them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

from orbisim.errors import SceneError
from orbisim.scene.patch.marked import Element

SECTIONS_OF_KINDS = {"actuator": "actuator"}
"""Sections whose elements are told apart by their names alone: a `<motor>` is a `<general>`."""
_ALIKE = {"freejoint": "joint"}


@dataclasses.dataclass(frozen=True)
class Change:
    """Attributes of an element that are other ones.

    Attributes:
      before, after: the element in both documents.
      attributes: new values; None where it has the attribute no more.
    """

    before: Element
    after: Element
    attributes: Mapping[str, str | None]


@dataclasses.dataclass(frozen=True)
class Insertion:
    """An element that is new.

    Attributes:
      parent: in the first document. previous: the sibling that it follows, None if it is first.
      element: in the second document.
    """

    parent: Element
    previous: Element | None
    element: Element


def differences(before: Element, after: Element) -> Iterator[Change | Insertion]:
    """The differences of two elements that stand for the same thing.

    Raises:
      SceneError: something of the first is not in the second.
    """
    changed: dict[str, str | None] = {
        name: value
        for name, value in after.attributes.items()
        if before.attributes.get(name) != value
    }
    changed |= {name: None for name in before.attributes if name not in after.attributes}
    if changed:
        yield Change(before, after, changed)
    pairs = {id(new): old for old, new in matched(before.children, after.children, before.tag)}
    gone = len(before.children) - len(pairs)
    if gone:
        raise SceneError("", f"{gone} elements in <{before.tag}> are no longer there")
    previous = None
    for new in after.children:
        old = pairs.get(id(new))
        if old is None:
            yield Insertion(before, previous, new)
        else:
            yield from differences(old, new)
            previous = old


def matched(
    first: Sequence[Element], second: Sequence[Element], section: str
) -> list[tuple[Element, Element]]:
    """Pairs of elements that stand for the same: by kind and name; without names, by their order.

    Of elements without names nothing is matched where their numbers differ, except that new ones
    may follow: `second` may have more.

    Args:
      section: tag of what they are in.
    """
    named = {_key(one, section): one for one in second if one.name}
    pairs, left = [], []
    for one in first:
        other = named.pop(_key(one, section), None) if one.name else None
        if other is None:
            left.append(one)
        else:
            pairs.append((one, other))
    taken = {id(other) for _, other in pairs}
    free: dict[str, list[Element]] = {}
    for other in second:
        if id(other) not in taken:
            free.setdefault(_kind(other, section), []).append(other)
    for one in left:
        rest = free.get(_kind(one, section), [])
        if rest and not (one.name and rest[0].name):
            pairs.append((one, rest.pop(0)))
    return pairs


def _kind(element: Element, section: str) -> str:
    return SECTIONS_OF_KINDS.get(section) or _ALIKE.get(element.tag, element.tag)


def _key(element: Element, section: str) -> tuple[str, str]:
    return _kind(element, section), element.name
