"""The elements of URDF that a scene stands for, and what their attributes must look like.

`clean` copies the part of a document that the grammar knows, every number checked, and lists the
rest. What comes out is safe for any URDF parser: no entities, no prefixes, no surprises.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping

from orbisim.errors import SceneError
from orbisim.scene.reading import Unsupported
from orbisim.scene.safety.xmlsafe import Node

NAME = -1
"""An attribute that must not be empty."""
TEXT = 0
"""An attribute that may hold anything. A positive number n means n finite numbers."""


@dataclasses.dataclass(frozen=True)
class Rule:
    """What an element may hold.

    Attributes:
      attributes: name to `NAME`, `TEXT` or how many numbers.
      required: attributes that must be there.
      children: tags of child elements, each with a rule of its own or handled by its reader.
      needs: children that must be there.
    """

    attributes: Mapping[str, int] = dataclasses.field(default_factory=dict)
    required: tuple[str, ...] = ()
    children: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()


_SHAPES = ("box", "cylinder", "sphere", "capsule", "mesh")
_ROUND = Rule({"radius": 1, "length": 1}, ("radius", "length"))
_REF = Rule({"link": NAME}, ("link",))
_SHAPE_HOLDER = ("origin", "geometry")

RULES: Mapping[str, Rule] = {
    "robot": Rule({"name": TEXT}, (), ("link", "joint", "material")),
    "link": Rule({"name": NAME}, ("name",), ("inertial", "visual", "collision")),
    "inertial": Rule({}, (), ("origin", "mass", "inertia")),
    "origin": Rule({"xyz": 3, "rpy": 3}),
    "mass": Rule({"value": 1}, ("value",)),
    "inertia": Rule(
        dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1), ("ixx", "iyy", "izz")
    ),
    "visual": Rule({"name": TEXT}, (), (*_SHAPE_HOLDER, "material"), ("geometry",)),
    "collision": Rule({"name": TEXT}, (), _SHAPE_HOLDER, ("geometry",)),
    "geometry": Rule({}, (), _SHAPES),
    "box": Rule({"size": 3}, ("size",)),
    "cylinder": _ROUND,
    "capsule": _ROUND,
    "sphere": Rule({"radius": 1}, ("radius",)),
    "mesh": Rule({"filename": NAME, "scale": 3}, ("filename",)),
    "material": Rule({"name": TEXT}, (), ("color", "texture")),
    "color": Rule({"rgba": 4}, ("rgba",)),
    "texture": Rule({"filename": TEXT}),
    "joint": Rule(
        {"name": NAME, "type": NAME},
        ("name", "type"),
        ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic"),
        ("parent", "child"),
    ),
    "parent": _REF,
    "child": _REF,
    "axis": Rule({"xyz": 3}, ("xyz",)),
    "limit": Rule(dict.fromkeys(("lower", "upper", "effort", "velocity"), 1)),
    "dynamics": Rule({"damping": 1, "friction": 1}),
    "mimic": Rule({"joint": NAME, "multiplier": 1, "offset": 1}, ("joint",)),
}

HANDLED_ELSEWHERE = {("robot", "mujoco"), ("robot", "orbisim"), ("robot", "transmission")}
"""Children that other modules read from the tree."""

MANY = {"link", "joint", "visual", "collision"}
"""Elements of which a parent may hold several, besides materials at the top level."""

CONSEQUENCES: Mapping[str, str] = {
    "gazebo": "settings for Gazebo are not applied",
    "ros2_control": "controllers are not made; see the option actuators",
    "sensor": "the sensor is not made",
    "calibration": "reference positions are not used",
    "safety_controller": "soft limits are not enforced",
    "contact": "contact parameters keep MuJoCo's defaults",
}

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
LARGEST = 1e30
"""Numbers beyond are refused: their squares and cubes must not overflow."""
_MACRO = re.compile(r"\$[({]")
_XACRO_REMEDY = "expand the macros first: xacro robot.urdf.xacro > robot.urdf"


class Cleaner:
    """Copies what the grammar knows and counts what it does not."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._unknown: dict[tuple[str, str], list[str]] = {}

    def clean(self, node: Node, inside: str = "") -> Node:
        """A copy of an element with everything below it.

        Args:
          inside: label of the nearest named element above, for messages.

        Raises:
          SceneError: an attribute is missing or not as the grammar wants it.
        """
        rule = RULES[node.tag]
        label = node.label() if node.get("name") or not inside else f"{inside}, {node.label()}"
        copy = Node(node.tag, self._attributes(node, rule, label))
        copy.line = node.line
        seen: set[str] = set()
        for child in node.nodes():
            if not self._known(node, child, rule, label, seen):
                continue
            seen.add(child.tag)
            copy.append(self.clean(child, label))
        for tag in rule.needs:
            if tag not in seen:
                raise SceneError(self._source, f"has no <{tag}>", element=label)
        if node.tag == "geometry" and len(copy) != 1:
            held = ", ".join(f"<{child.tag}>" for child in node.nodes()) or "nothing"
            raise SceneError(
                self._source, f"holds {held}; expected one of {', '.join(_SHAPES)}", element=label
            )
        return copy

    def unsupported(self) -> tuple[Unsupported, ...]:
        """What was left out, one line for each kind."""
        return tuple(
            Unsupported(
                labels[0] if len(labels) == 1 else f"{labels[0]} and {len(labels) - 1} more",
                f"<{tag}> in <{parent}>",
                CONSEQUENCES.get(tag.rpartition(":")[2], "ignored"),
            )
            for (parent, tag), labels in self._unknown.items()
        )

    def _known(self, node: Node, child: Node, rule: Rule, label: str, seen: set[str]) -> bool:
        if child.tag.startswith("xacro:"):
            raise SceneError(
                self._source,
                "is a xacro macro, not plain URDF",
                element=f"<{child.tag}> (line {child.line})",
                remedy=_XACRO_REMEDY,
            )
        if child.tag not in rule.children:
            if (node.tag, child.tag) not in HANDLED_ELSEWHERE:
                shown = child.label() if child.get("name") else f"{label}, {child.label()}"
                self._unknown.setdefault((node.tag, child.tag), []).append(shown)
            return False
        repeated = child.tag in seen and child.tag not in MANY
        if repeated and not (node.tag == "robot" and child.tag == "material"):
            raise SceneError(
                self._source, f"has more than one <{child.tag}>", element=label, remedy="keep one"
            )
        return True

    def _attributes(self, node: Node, rule: Rule, label: str) -> dict[str, str]:
        for name in rule.required:
            if name not in node.attrib:
                raise SceneError(self._source, f"has no attribute {name!r}", element=label)
        return {
            name: self._value(node, name, kind, label)
            for name, kind in rule.attributes.items()
            if name in node.attrib
        }

    def _value(self, node: Node, name: str, kind: int, label: str) -> str:
        text = node.attrib[name]
        if kind == TEXT:
            return text
        if kind == NAME:
            if not text.strip():
                raise SceneError(self._source, f"{name} is empty", element=label)
            return text
        numbers = finite_numbers(text)
        if (node.tag, name) == ("mesh", "scale") and len(numbers or ()) == 1:
            return text
        if numbers is None or len(numbers) != kind:
            what = "one finite number" if kind == 1 else f"{kind} finite numbers"
            raise SceneError(
                self._source,
                f"{name}={text[:60]!r}; expected {what} up to {LARGEST:g}",
                element=label,
                remedy=_XACRO_REMEDY if _MACRO.search(text) else None,
            )
        return " ".join(repr(number) for number in numbers)


def finite_numbers(text: str) -> tuple[float, ...] | None:
    """Numbers separated by blanks or commas; None if one is no decimal up to `LARGEST`."""
    tokens = text.replace(",", " ").split()
    if not all(_NUMBER.fullmatch(token) for token in tokens):
        return None
    numbers = tuple(float(token) for token in tokens)
    return numbers if all(abs(number) <= LARGEST for number in numbers) else None
