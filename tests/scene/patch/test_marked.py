"""Elements and the bytes that they stand on."""

from __future__ import annotations

from pathlib import Path

import pytest

from orbisim.errors import SceneError
from orbisim.scene.patch.marked import end_of_tag, parsed, read

TEXT = """<?xml version="1.0"?>
<!-- <joint name="no"/> -->
<mujoco><!-- ü --><worldbody>
  <body name="a > b"><joint
     name='j'/></body ></worldbody>
  <include file="more.xml"/></mujoco>"""


def test_places(tmp_path: Path) -> None:
    (tmp_path / "main.xml").write_text(TEXT)
    (tmp_path / "more.xml").write_text("<mujocoinclude><option/></mujocoinclude>")
    root = read(tmp_path / "main.xml")
    data = (tmp_path / "main.xml").read_bytes()
    body = next(one for one in root.descendants() if one.tag == "body")
    assert data[body.start : body.inner] == b'<body name="a > b">'
    assert data[body.start : body.end].endswith(b"</body >")
    joint = body.children[0]
    assert data[joint.start : joint.end] == b"<joint\n     name='j'/>"
    option = root.children[-1]
    assert (option.tag, option.file) == ("option", (tmp_path / "more.xml").resolve())


def test_quotes_may_hold_the_end_of_a_tag() -> None:
    assert end_of_tag(b"""<a b='>"' c=">'">x""", 0) == len(b"""<a b='>"' c=">'">""")


def test_text_is_read_as_data() -> None:
    element = parsed("<custom><text name='n'><![CDATA[ {\"a\": 1} ]]></text></custom>")
    assert element.children[0].attributes == {"name": "n", "data": '{"a": 1}'}


def test_includes_without_end(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text("<mujoco><include file='a.xml'/></mujoco>")
    with pytest.raises(SceneError, match="files deep"):
        read(tmp_path / "a.xml")
    (tmp_path / "b.xml").write_text("<mujoco><include file='c.xml'/></mujoco>")
    with pytest.raises(SceneError, match=r"'c\.xml' is not there"):
        read(tmp_path / "b.xml")
