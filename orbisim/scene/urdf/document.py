"""From URDF text to a `Robot`: checked, parsed by yourdfpy, typed."""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import numpy as np

from orbisim.errors import MissingDependencyError, SceneError
from orbisim.scene.safety import xmlsafe
from orbisim.scene.safety.xmlsafe import Node
from orbisim.scene.urdf.grammar import Cleaner
from orbisim.scene.urdf.model import Array, Inertial, Joint, Link, Mimic, Rgba, Robot, Shape
from orbisim.scene.urdf.transmissions import read_transmissions
from orbisim.scene.urdf.tree import check_joints, find_root, unique

MAX_LINKS = 4000
"""More are refused: large robots have a few hundred."""


def read_document(data: bytes | str, source: str) -> Robot:
    """Reads a URDF document.

    Raises:
      SceneError: it is not URDF, a number is broken, a reference leads nowhere, or the links do
        not form one tree.
      MissingDependencyError: yourdfpy is not installed.
    """
    root = xmlsafe.parse(data, source)
    if root.tag != "robot":
        raise SceneError(source, f"URDF starts with <robot>; got <{root.tag}>")
    count = len(root.children("link"))
    if count > MAX_LINKS:
        raise SceneError(source, f"has {count} links; at most {MAX_LINKS} are read")
    cleaner = Cleaner(source)
    clean = cleaner.clean(root)
    clean.set("name", clean.get("name") or "robot")
    unique(clean.children("link"), source)
    unique(clean.children("joint"), source)
    reader = _Reader(clean, source)
    links = {link.name: link for link in reader.links()}
    joints = {joint.name: joint for joint in reader.joints()}
    check_joints(links, joints, source)
    transmissions, idle = read_transmissions(root, joints)
    return Robot(
        name=clean.attrib["name"],
        links=links,
        joints=joints,
        transmissions=transmissions,
        root=find_root(links, joints, source),
        extension=root.child("mujoco"),
        own_extension=root.child("orbisim"),
        unsupported=(*cleaner.unsupported(), *idle),
        warnings=tuple(reader.warnings),
    )


class _Reader:
    """Puts what yourdfpy made of a clean document beside the document's own lines."""

    def __init__(self, clean: Node, source: str) -> None:
        self._tree, self._source = clean, source
        self._capsules = _rename_capsules(clean)
        self._robot = _parse(clean, source)
        self._colors = _color_table(clean)
        self.warnings: list[str] = []

    def links(self) -> Iterator[Link]:
        """The links, in the order of the document."""
        for node, link in zip(self._tree.children("link"), self._robot.links, strict=True):
            yield Link(
                label=node.label(),
                name=link.name,
                inertial=_inertial(link.inertial),
                collisions=tuple(self._shapes(node, "collision", link.collisions)),
                visuals=tuple(self._shapes(node, "visual", link.visuals)),
            )

    def joints(self) -> Iterator[Joint]:
        """The joints, in the order of the document."""
        for node, joint in zip(self._tree.children("joint"), self._robot.joints, strict=True):
            pos, rotation = _frame(joint.origin)
            limit, dynamics = joint.limit, joint.dynamics
            yield Joint(
                label=node.label(),
                name=joint.name,
                type=joint.type,
                parent=joint.parent,
                child=joint.child,
                pos=pos,
                rotation=rotation,
                axis=np.asarray(joint.axis, np.float64),
                damping=float((dynamics and dynamics.damping) or 0.0),
                friction=float((dynamics and dynamics.friction) or 0.0),
                lower=limit and limit.lower,
                upper=limit and limit.upper,
                effort=limit and limit.effort,
                velocity=limit and limit.velocity,
                mimic=joint.mimic
                and Mimic(joint.mimic.joint, joint.mimic.multiplier, joint.mimic.offset),
            )

    def _shapes(self, link: Node, tag: str, shapes: list[Any]) -> Iterator[Shape]:
        for number, (node, shape) in enumerate(
            zip(link.children(tag), shapes, strict=True), start=1
        ):
            label = f"link {link.get('name')!r}, {tag} {number} (line {node.line})"
            yield self._shape(node, shape, label)

    def _shape(self, node: Node, shape: Any, label: str) -> Shape:
        geometry = shape.geometry
        pos, rotation = _frame(shape.origin)
        common: dict[str, Any] = {
            "label": label, "name": shape.name or "", "pos": pos, "rotation": rotation
        }  # fmt: skip
        material = node.child("material")
        if material is not None:
            common["rgba"] = self._rgba(material, label)
            common["textured"] = material.child("texture") is not None
        if geometry.mesh is not None:
            scale = np.broadcast_to(
                1.0 if geometry.mesh.scale is None else geometry.mesh.scale, 3
            ).tolist()
            return Shape(kind="mesh", file=geometry.mesh.filename, scale=tuple(scale), **common)
        if geometry.box is not None:
            return Shape(kind="box", size=_sizes(geometry.box.size), **common)
        if geometry.sphere is not None:
            return Shape(kind="sphere", size=_sizes([geometry.sphere.radius]), **common)
        size = _sizes([geometry.cylinder.radius, geometry.cylinder.length])
        if id(node) in self._capsules:
            return Shape(kind="capsule", size=size, **common)
        return Shape(kind="cylinder", size=size, **common)

    def _rgba(self, material: Node, label: str) -> Rgba | None:
        color = material.child("color")
        if color is not None:
            return _rgba(color)
        name = material.get("name", "")
        if name not in self._colors and material.child("texture") is None:
            self.warnings.append(f"{label}: no material {name!r} with a colour is defined")
        return self._colors.get(name)


def _parse(clean: Node, source: str) -> Any:
    """The document as yourdfpy's dataclasses; nothing but its XML is read."""
    try:
        import yourdfpy
    except ImportError as error:
        raise MissingDependencyError("URDF scenes", "urdf", str(error)) from None
    text = ElementTree.tostring(clean, encoding="utf-8")
    log = logging.getLogger("yourdfpy")
    level = log.level
    log.setLevel(logging.CRITICAL)  # what it would log is raised
    try:
        return yourdfpy.URDF.load(
            io.BytesIO(text),
            build_scene_graph=False,
            build_collision_scene_graph=False,
            load_meshes=False,
            load_collision_meshes=False,
        ).robot
    except Exception as error:  # whatever a third party raises on a document
        raise SceneError(source, f"yourdfpy refuses it: {error}") from None
    finally:
        log.setLevel(level)


def _rename_capsules(clean: Node) -> set[int]:
    """Writes capsules, which yourdfpy does not know, as cylinders; returns who holds one."""
    found: set[int] = set()
    for holder in [*clean.iter("visual"), *clean.iter("collision")]:
        for capsule in holder.iter("capsule"):
            capsule.tag = "cylinder"
            found.add(id(holder))
    return found


def _color_table(clean: Node) -> dict[str, Rgba]:
    """Colours by material name: the first definition counts, wherever it stands."""
    table: dict[str, Rgba] = {}
    for material in clean.descendants():
        color = material.child("color") if material.tag == "material" else None
        if color is not None and material.get("name"):
            table.setdefault(material.attrib["name"], _rgba(color))
    return table


def _rgba(color: Node) -> Rgba:
    red, green, blue, alpha = (float(x) for x in color.attrib["rgba"].split())
    return red, green, blue, alpha


def _frame(origin: Any) -> tuple[Array, Array]:
    matrix = np.eye(4) if origin is None else np.asarray(origin, np.float64)
    return matrix[:3, 3].copy(), matrix[:3, :3].copy()


def _inertial(inertial: Any) -> Inertial | None:
    """None where there is no mass."""
    if inertial is None or inertial.mass is None:
        return None
    com, rotation = _frame(inertial.origin)
    tensor = np.full((3, 3), np.nan) if inertial.inertia is None else inertial.inertia
    return Inertial(float(inertial.mass), com, rotation @ tensor @ rotation.T)


def _sizes(values: Any) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
