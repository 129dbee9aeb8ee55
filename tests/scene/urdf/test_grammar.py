"""What elements of URDF may hold."""

from __future__ import annotations

import pytest

from orbisim.errors import SceneError
from orbisim.scene.safety.xmlsafe import Node, parse
from orbisim.scene.urdf.grammar import RULES, Cleaner, finite_numbers

from .urdf_text import joint, link, robot


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("1 2,3", (1.0, 2.0, 3.0)), (" -1.5e3 ", (-1500.0,)), (".5 5.", (0.5, 5.0)), ("", ()),
        ("nan", None), ("inf", None), ("1e31", None), ("0x1", None),
        ("1_0", None), ("\u0661", None),
    ],
)  # fmt: skip
def test_numbers(text: str, numbers: tuple[float, ...] | None) -> None:
    assert finite_numbers(text) == numbers


def cleaned(text: str) -> tuple[Node, Cleaner]:
    cleaner = Cleaner("s")
    return cleaner.clean(parse(text, "s")), cleaner


def test_what_is_known_is_copied_and_the_rest_is_listed() -> None:
    root, cleaner = cleaned(robot("<gazebo/>", "<gazebo/>", "<foo/>", link("a")))
    assert [node.tag for node in root.nodes()] == ["link"]
    gazebo, foo = cleaner.unsupported()
    assert gazebo.feature == "<gazebo> in <robot>"
    assert gazebo.element.endswith("and 1 more")
    assert gazebo.consequence == "settings for Gazebo are not applied"
    assert foo.consequence == "ignored"


def test_a_clean_document_stays_as_it_is() -> None:
    root, cleaner = cleaned(robot(link("a"), link("b"), joint("j", "a", "b")))
    again = Cleaner("s").clean(root)
    assert [n.attrib for n in again.descendants()] == [n.attrib for n in root.descendants()]
    assert cleaner.unsupported() == ()


SHAPE = "<geometry><sphere radius='1'/></geometry>"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot><link/></robot>", "has no attribute 'name'"),
        ("<robot><link name=' '/></robot>", "name is empty"),
        (robot(link("a", "<inertial/><inertial/>")), "has more than one <inertial>"),
        (robot(link("a", "<visual/>")), "has no <geometry>"),
        (robot(link("a", "<visual><geometry/></visual>")), "holds nothing; expected one of box"),
        (robot(link("a", f"<visual>{SHAPE}<origin xyz='1 2'/></visual>")), "expected 3 finite"),
        (robot(link("a", f"<visual>{SHAPE}<origin xyz='${{x}} 0 0'/></visual>")), "xacro robot"),
        (robot("<xacro:macro/>"), "is a xacro macro"),
        (robot("<joint name='j' type='fixed'><child link='a'/></joint>"), "has no <parent>"),
    ],
)
def test_what_is_refused(text: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        cleaned(text)


def test_every_child_has_a_rule() -> None:
    assert {child for rule in RULES.values() for child in rule.children} <= set(RULES)
