"""The links of a document form one tree."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim.errors import SceneError
from orbisim.scene.safety.xmlsafe import parse
from orbisim.scene.urdf.model import Joint, Link, Mimic
from orbisim.scene.urdf.tree import check_joints, find_root, unique


def links(names: str) -> dict[str, Link]:
    return {name: Link(f"link {name!r}", name, None, (), ()) for name in names}


def joint(name: str, parent: str, child: str, **changes: object) -> Joint:
    values: dict = {"type": "revolute", "axis": np.array([0, 0, 1.0])}
    frame = {"pos": np.zeros(3), "rotation": np.eye(3)}
    return Joint(
        f"joint {name!r}", name, parent=parent, child=child, **{**frame, **values, **changes}
    )


def joints(*all_: Joint) -> dict[str, Joint]:
    return {one.name: one for one in all_}


def test_the_root_is_the_link_without_a_parent() -> None:
    tree = joints(joint("1", "b", "a"), joint("2", "c", "b"), joint("3", "c", "d"))
    assert find_root(links("abcd"), tree, "s") == "c"
    assert find_root(links("a"), {}, "s") == "a"


@pytest.mark.parametrize(
    ("names", "pairs", "message"),
    [
        ("abc", ["ab", "cb"], "already the child of joint 'ab'"),
        ("abc", ["ab", "bc", "ca"], "form a loop through links 'a', 'c', 'b'|form a loop"),
        ("abc", ["ab"], "2 links have no parent .*'a', 'c'"),
    ],
)
def test_what_is_no_tree(names: str, pairs: list[str], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        find_root(links(names), joints(*(joint(pair, *pair) for pair in pairs)), "s")


def test_the_world_has_no_parent() -> None:
    both = {**links("a"), "world": Link("link 'world'", "world", None, (), ())}
    with pytest.raises(SceneError, match="a link named 'world' is the world"):
        find_root(both, joints(joint("j", "a", "world")), "s")


@pytest.mark.parametrize(
    ("one", "message"),
    [
        (joint("j", "a", "b", type="hinge"), "has the type 'hinge'; expected one of revolute"),
        (joint("j", "a", "bb"), "its child 'bb' is not a link of the robot; did you mean 'b'"),
        (joint("j", "a", "a"), "connects link 'a' with itself"),
        (joint("j", "a", "b", axis=np.zeros(3)), "its axis is zero"),
        (joint("j", "a", "b", lower=1.0, upper=-1.0), "lower 1 is above upper -1"),
        (joint("j", "a", "b", lower=1.0, upper=1.0), "both 1; make the joint fixed"),
        (joint("j", "a", "b", damping=-1.0), r"its damping is negative \(-1\)"),
        (joint("j", "a", "b", mimic=Mimic("i", 1, 0)), "mimics 'i', which is not a joint"),
        (joint("j", "a", "b", mimic=Mimic("j", 1, 0)), "mimics 'j', which mimics it in turn"),
    ],
)
def test_joints_that_cannot_be(one: Joint, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        check_joints(links("ab"), joints(one), "s")


def test_joints_that_can() -> None:
    fixed = joint("k", "a", "c", type="fixed", axis=np.zeros(3))
    check_joints(links("abc"), joints(joint("j", "a", "b", mimic=Mimic("k", 1, 0)), fixed), "s")
    with pytest.raises(SceneError, match="holds no <link>"):
        check_joints({}, {}, "s")


def test_names_are_unique() -> None:
    nodes = parse("<r><l name='a'/>\n<l name='b'/>\n<l name='a'/></r>", "s").nodes()
    unique(nodes[:2], "s")
    with pytest.raises(SceneError, match=r"l 'a' \(line 3\): the name is taken by line 1"):
        unique(nodes, "s")
