"""Names and references: the links of a URDF document form one tree."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from orbisim.errors import SceneError
from orbisim.scene.safety.xmlsafe import Node
from orbisim.scene.urdf.model import WORLD, Joint, Link

JOINT_TYPES = (
    "revolute",
    "continuous",
    "prismatic",
    "fixed",
    "floating",
    "planar",
    "spherical",
)
"""The types of URDF, and `spherical`, an extension that MuJoCo and Bullet share."""

_WITH_AXIS = ("revolute", "continuous", "prismatic", "planar")
_SHORTEST_AXIS = 1e-14  # MuJoCo's mjEPS
_LOOP_REMEDY = "URDF describes trees; close loops in MJCF with an equality constraint"


def unique(nodes: Sequence[Node], source: str) -> None:
    """Raises `SceneError` if two elements have the same name."""
    seen: dict[str, Node] = {}
    for node in nodes:
        name = node.attrib["name"]
        if name in seen:
            raise SceneError(
                source,
                f"the name is taken by line {seen[name].line}",
                element=node.label(),
                remedy="give every link and every joint a name of its own",
            )
        seen[name] = node


def check_joints(links: Mapping[str, Link], joints: Mapping[str, Joint], source: str) -> None:
    """Checks each joint on its own: type, axis, limits, references.

    Raises:
      SceneError: something is wrong with a joint.
    """
    if not links:
        raise SceneError(source, "holds no <link>", remedy="a robot has at least one link")
    for joint in joints.values():
        problem = (
            _type_problem(joint)
            or _link_problem(joint, links)
            or _axis_problem(joint)
            or _limit_problem(joint)
            or _dynamics_problem(joint)
        )
        if problem:
            raise SceneError(source, problem[0], element=joint.label, remedy=problem[1])
    _check_mimics(joints, source)


def find_root(links: Mapping[str, Link], joints: Mapping[str, Joint], source: str) -> str:
    """Name of the one link without a parent, from which all others can be reached.

    Raises:
      SceneError: a link has two parents, or the joints form a loop, or there are several trees.
    """
    parent: dict[str, Joint] = {}
    for joint in joints.values():
        if joint.child in parent:
            raise SceneError(
                source,
                f"link {joint.child!r} is already the child of joint "
                f"{parent[joint.child].name!r}; a link has one parent",
                element=joint.label,
                remedy=_LOOP_REMEDY,
            )
        parent[joint.child] = joint
    _check_no_cycle(links, parent, source)
    roots = [name for name in links if name not in parent]
    if len(roots) > 1:
        raise SceneError(
            source,
            f"{len(roots)} links have no parent ({', '.join(repr(r) for r in roots[:6])}); "
            "expected one root",
            element=links[roots[1]].label,
            remedy="connect them with joints (type fixed, say) or remove those that are not used",
        )
    if WORLD in parent:
        raise SceneError(
            source,
            "a link named 'world' is the world and cannot have a parent",
            element=links[WORLD].label,
            remedy="rename it",
        )
    return roots[0]


def _check_no_cycle(links: Mapping[str, Link], parent: Mapping[str, Joint], source: str) -> None:
    anchored: set[str] = set()
    for start in links:
        path: list[str] = []
        on_path: set[str] = set()
        name = start
        while name in parent and name not in anchored:
            if name in on_path:
                raise SceneError(
                    source,
                    f"the joints form a loop through links {_shown(path[path.index(name) :])}",
                    element=parent[name].label,
                    remedy=_LOOP_REMEDY,
                )
            path.append(name)
            on_path.add(name)
            name = parent[name].parent
        anchored.update(path)


def _shown(names: Sequence[str]) -> str:
    return ", ".join(repr(name) for name in names[:6]) + (", ..." if len(names) > 6 else "")


Problem = tuple[str, str | None] | None


def _type_problem(joint: Joint) -> Problem:
    if joint.type in JOINT_TYPES:
        return None
    return f"has the type {joint.type!r}; expected one of {', '.join(JOINT_TYPES)}", None


def _link_problem(joint: Joint, links: Iterable[str]) -> Problem:
    for role, name in (("parent", joint.parent), ("child", joint.child)):
        if name not in links:
            close = difflib.get_close_matches(name, links, n=1)
            remedy = f"did you mean {close[0]!r}?" if close else "declare that link"
            return f"its {role} {name!r} is not a link of the robot", remedy
    if joint.parent == joint.child:
        return f"connects link {joint.parent!r} with itself", _LOOP_REMEDY
    return None


def _axis_problem(joint: Joint) -> Problem:
    if joint.type in _WITH_AXIS and not np.linalg.norm(joint.axis) > _SHORTEST_AXIS:
        return "its axis is zero", "give a direction, such as xyz='0 0 1'"
    return None


def _limit_problem(joint: Joint) -> Problem:
    lower, upper = joint.lower, joint.upper
    if lower is None or upper is None:
        return None
    if lower > upper:
        return (
            f"its limits are inverted: lower {lower:g} is above upper {upper:g}",
            "swap them, or make the joint continuous if it has none",
        )
    if lower == upper != 0.0 and joint.type in ("revolute", "prismatic"):
        return f"its lower and upper limits are both {lower:g}", "make the joint fixed"
    return None


def _dynamics_problem(joint: Joint) -> Problem:
    for name, value in (("damping", joint.damping), ("friction", joint.friction)):
        if value < 0.0:
            return f"its {name} is negative ({value:g})", "give zero or a positive number"
    return None


def _check_mimics(joints: Mapping[str, Joint], source: str) -> None:
    sound: set[str] = set()
    for joint in joints.values():
        chain = {joint.name}
        while joint.mimic is not None and joint.name not in sound:
            leader = joint.mimic.joint
            if leader not in joints:
                close = difflib.get_close_matches(leader, joints, n=1)
                raise SceneError(
                    source,
                    f"mimics {leader!r}, which is not a joint of the robot",
                    element=joint.label,
                    remedy=f"did you mean {close[0]!r}?" if close else "declare that joint",
                )
            if leader in chain:
                raise SceneError(
                    source,
                    f"mimics {leader!r}, which mimics it in turn",
                    element=joint.label,
                    remedy="let one joint of the chain be free",
                )
            chain.add(leader)
            joint = joints[leader]
        sound |= chain
