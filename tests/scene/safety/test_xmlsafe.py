"""XML from strangers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbisim.errors import SceneError
from orbisim.scene.safety.xmlsafe import XmlLimits, parse, without_comments

DOCUMENT = "<a>\n  <b name='one'/>\n  <sensor:c x='1'>text</sensor:c>\n</a>"


def test_elements_know_their_line() -> None:
    root = parse(DOCUMENT, "s")
    assert [(node.tag, node.line) for node in root.nodes()] == [("b", 2), ("sensor:c", 3)]
    assert root.children("b")[0].label() == "b 'one' (line 2)"
    assert root.label() == "<a> (line 1)"
    assert root.nodes()[1].text == "text"
    assert [node.tag for node in root.descendants()] == ["a", "b", "sensor:c"]


@pytest.mark.parametrize(
    "data",
    [
        DOCUMENT.encode(),
        b"\xef\xbb\xbf" + DOCUMENT.encode(),
        b"\n  <?xml version='1.0'?>" + DOCUMENT.encode(),
        DOCUMENT.encode() + b"\0",
        DOCUMENT.encode("utf-16"),
        "<?xml version='1.0' encoding='latin-1'?><a><b name='\xe9'/><c/></a>".encode("latin-1"),
        "<?xml version='1.0' encoding='utf-16'?>" + DOCUMENT,
        "\ufeff" + DOCUMENT,
    ],
)
def test_encodings(data: bytes | str) -> None:
    root = parse(data, "s")
    assert len(root.nodes()) == 2
    assert root.children("b")[0].get("name") in ("one", "\xe9")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "the document is empty"),
        (b"  \n", "the document is empty"),
        (b"<a>\0</a>", "byte 3 is NUL"),
        (b"<a>\n\xff</a>", "line 2: byte 0xff is not UTF-8"),
        (b"<a><b></a>", "not well-formed XML: line 1, column"),
        ("plain text", "an XML document starts with '<'"),
        (b"<?xml version='1.0' encoding='klingon'?><a/>", "encoding"),
        (b"<!DOCTYPE a [<!ENTITY e 'x'>]><a>&e;</a>", "EntitiesForbidden"),
    ],
)
def test_what_is_refused(data: bytes | str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        parse(data, "s")


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        (XmlLimits(nbytes=30), "at most 30 are read"),
        (XmlLimits(elements=2), r"more than 2 elements.*|sensor:c"),
        (XmlLimits(depth=1), "nested more than 1 deep"),
    ],
)
def test_bounds(limits: XmlLimits, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        parse(DOCUMENT, "s", limits)
    parse(DOCUMENT, "s", XmlLimits(nbytes=len(DOCUMENT), elements=3, depth=2))


def test_long_names_are_cut_in_messages() -> None:
    (node,) = parse(f"<a><{'b' * 500} name='{'c' * 500}'/></a>", "s").nodes()
    assert len(node.label()) < 200


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"<a><!-- x --><b/></a>", b"<a><b/></a>"),
        (b"<!-- one\ntwo\n--><a/>", b"\n\n<a/>"),
        (b"<a/><!-- open\n", b"<a/>\n"),
        (b"<!----><a/>", b"<a/>"),
        (b"<a/>", b"<a/>"),
    ],
)
def test_comments(data: bytes, expected: bytes) -> None:
    assert without_comments(data) == expected


@given(st.binary(max_size=200) | st.text(max_size=200))
def test_any_bytes_are_read_or_refused(data: bytes | str) -> None:
    try:
        parse(data, "s")
    except SceneError as error:
        assert str(error).startswith("s")
