"""Writes a mechanism as URDF with a mesh for each part."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

from orbisim.files.writing import make_folder, write_bytes, write_text
from orbisim.tasks.mechanisms.model import Joint, Mechanism, Part
from orbisim.tasks.mechanisms.solids import Solid, mass_properties, surface

Element = ElementTree.Element
RIGID = {"solreffriction": "0.004 1", "solimpfriction": "0.9999 0.9999 0.001 0.5 2"}
"""Friction that holds: with MuJoCo's defaults a locked joint creeps under load."""


def write_urdf(mechanism: Mechanism, folder: Path) -> Path:
    """Writes `NAME.urdf` and its meshes (binary STL) to a folder; returns the document's path.

    Raises:
      OutputError: the folder cannot be written.
    """
    make_folder(folder / "meshes")
    root = Element("robot", name=mechanism.name)
    for part in mechanism.parts:
        root.append(_link(part, folder))
    for joint in mechanism.joints:
        root.append(_joint(joint))
    root.append(_extension(mechanism))
    ElementTree.indent(root)
    path = folder / f"{mechanism.name}.urdf"
    write_text(path, ElementTree.tostring(root, encoding="unicode") + "\n")
    return path


def _link(part: Part, folder: Path) -> Element:
    link = Element("link", name=part.name)
    mass, com, tensor = mass_properties(part.solids, part.density)
    inertial = _child(link, "inertial")
    _child(inertial, "origin", xyz=_text(com), rpy="0 0 0")
    _child(inertial, "mass", value=repr(mass))
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    places = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    values = {name: repr(float(tensor[at])) for name, at in zip(names, places, strict=True)}
    _child(inertial, "inertia", **values)
    visual = _child(link, "visual", name=f"{part.name}_visual")
    _child(visual, "origin", xyz="0 0 0", rpy="0 0 0")
    _child(_child(visual, "geometry"), "mesh", filename=f"meshes/{part.name}.stl")
    write_bytes(folder / f"meshes/{part.name}.stl", surface(part.solids).export(file_type="stl"))
    material = _child(visual, "material", name=f"{part.name}_colour")
    _child(material, "color", rgba=f"{_text(part.rgb)} 1")
    for number, solid in enumerate(part.solids):
        collision = _child(link, "collision", name=f"{part.name}_{number}")
        _child(collision, "origin", xyz=_text(solid.pos), rpy=_text(solid.rpy))
        _shape(_child(collision, "geometry"), solid, folder, f"{part.name}_{number}")
    return link


def _shape(geometry: Element, solid: Solid, folder: Path, name: str) -> None:
    if solid.kind == "box":
        _child(geometry, "box", size=_text(solid.size))
    elif solid.kind == "cylinder":
        radius, length = solid.size
        _child(geometry, "cylinder", radius=repr(float(radius)), length=repr(float(length)))
    else:
        file = f"meshes/{name}.stl"
        write_bytes(folder / file, solid.mesh(placed=False).export(file_type="stl"))
        _child(geometry, "mesh", filename=file)


def _joint(joint: Joint) -> Element:
    kind = {"hinge": "revolute", "slide": "prismatic"}[joint.kind]
    node = Element("joint", name=joint.name, type=kind)
    _child(node, "parent", link=joint.parent)
    _child(node, "child", link=joint.child)
    _child(node, "origin", xyz=_text(joint.pos), rpy="0 0 0")
    _child(node, "axis", xyz=_text(joint.axis))
    _child(node, "limit", lower=repr(float(joint.lower)), upper=repr(float(joint.upper)))
    _child(node, "dynamics", damping=repr(joint.damping), friction=repr(joint.friction))
    return node


def _extension(mechanism: Mechanism) -> Element:
    root = Element("orbisim")
    for joint in mechanism.joints:
        spring = {
            "stiffness": repr(float(joint.stiffness)),
            "springref": repr(float(joint.rest)),
            "armature": repr(float(joint.armature)),
        }
        _child(root, "joint", name=joint.name, **spring, **RIGID)
    for effect in mechanism.effects:
        node = _child(root, "effect", name=effect.effect, target=effect.target)
        for name, value in effect.values.items():
            _child(node, "parameter", name=name, value=repr(float(value)))
        for name, choice in effect.options.items():
            _child(node, "option", name=name, value=choice)
    _child(root, "collision", self="false")
    return root


def _child(parent: Element, tag: str, /, **attributes: str) -> Element:
    return ElementTree.SubElement(parent, tag, attributes)


def _text(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
