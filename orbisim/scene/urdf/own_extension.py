"""`<orbisim>` in a URDF document: what neither URDF nor MuJoCo's extension of it can say.

    <orbisim>
      <joint name="handle" stiffness="0.8" springref="0.1" armature="0.001"/>
      <effect name="latch" target="leaf">
        <parameter name="force" value="200"/>
        <option name="other" value="handle"/>
      </effect>
      <collision self="false"/>
    </orbisim>

`<joint>` takes attributes of MuJoCo's joint that URDF lacks, `<effect>` is carried to the classical
backends (see `orbisim.effects`), `<collision self="false">` keeps the links from touching each
other; they still touch everything else.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco

from orbisim.errors import SceneError
from orbisim.scene.reading import Unsupported
from orbisim.scene.safety.xmlsafe import Node
from orbisim.scene.texts import ACTING, replace_text
from orbisim.scene.urdf.grammar import finite_numbers

_JOINT: Mapping[str, tuple[str, int]] = {
    "stiffness": ("stiffness", 1),
    "springref": ("springref", 1),
    "armature": ("armature", 1),
    "solreffriction": ("solref_friction", 2),
    "solimpfriction": ("solimp_friction", 5),
}
"""Attribute of the element: field of `MjsJoint`, and how many numbers it has."""
_SCALAR = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


def apply_extension(node: Node | None, spec: mujoco.MjSpec, source: str) -> tuple[Unsupported, ...]:
    """Writes what the element says into the scene; returns what it has that is not known.

    Args:
      node: the element; None where the document has none.
      spec: the scene, with its joints and geoms.

    Raises:
      SceneError: a joint is not there, or a number is broken. Whether effects fit the scene is
        checked when it is compiled.
    """
    unsupported: list[Unsupported] = []
    effects: list[dict[str, object]] = []
    for child in node.nodes() if node is not None else []:
        if child.tag == "joint":
            _joint(child, spec, source)
        elif child.tag == "effect":
            effects.append(_effect(child, source))
        elif child.tag == "collision":
            _collision(child, spec, source)
        else:
            unsupported.append(
                Unsupported(f"{child.label()} in <orbisim>", "no part of the extension", "ignored")
            )
    if effects:
        replace_text(spec, ACTING[0], effects)
    return tuple(unsupported)


def _joint(node: Node, spec: mujoco.MjSpec, source: str) -> None:
    label = f"<orbisim>, {node.label()}"
    element = spec.joint(_attribute(node, "name", source))
    if element is None or element.type not in _SCALAR:
        raise SceneError(
            source, "names no revolute, continuous or prismatic joint of the robot", element=label
        )
    for name in node.attrib:
        if name == "name":
            continue
        if name not in _JOINT:
            raise SceneError(
                source, f"has an attribute {name!r}; known are {', '.join(_JOINT)}", element=label
            )
        field, count = _JOINT[name]
        numbers = _numbers(node, name, count, source)
        if name == "stiffness":
            element.stiffness[0] = numbers[0]
        else:
            setattr(element, field, numbers[0] if count == 1 else numbers)


def _effect(node: Node, source: str) -> dict[str, object]:
    """As `orbisim.effects` has it in the scene's text."""
    found: dict[str, object] = {
        "effect": _attribute(node, "name", source),
        "target": _attribute(node, "target", source),
        "parameters": {
            _attribute(child, "name", source): _numbers(child, "value", 1, source)[0]
            for child in node.children("parameter")
        },
    }
    options = {
        _attribute(child, "name", source): _attribute(child, "value", source)
        for child in node.children("option")
    }
    return {**found, "options": options} if options else found


def _collision(node: Node, spec: mujoco.MjSpec, source: str) -> None:
    self_collides = _attribute(node, "self", source)
    if self_collides not in ("true", "false"):
        raise SceneError(
            source, f"self={self_collides[:60]!r}; expected true or false", element=node.label()
        )
    if self_collides == "false":
        for geom in spec.geoms:
            geom.conaffinity = 0  # a pair touches if either side's type is in the other's affinity


def _attribute(node: Node, name: str, source: str) -> str:
    value = node.get(name, "")
    if not value.strip():
        raise SceneError(source, f"has no attribute {name!r}", element=f"<orbisim>, {node.label()}")
    return value


def _numbers(node: Node, name: str, count: int, source: str) -> list[float]:
    text = _attribute(node, name, source)
    numbers = finite_numbers(text)
    if numbers is None or len(numbers) != count:
        what = "one finite number" if count == 1 else f"{count} finite numbers"
        raise SceneError(
            source,
            f"{name}={text[:60]!r}; expected {what}",
            element=f"<orbisim>, {node.label()}",
        )
    return list(numbers)
