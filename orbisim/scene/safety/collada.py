"""COLLADA, made safe and whole before a parser sees it.

Parsers drop every node that uses a material they cannot resolve, and most broken references in
COLLADA files concern textures, which are not loaded here anyway. `prepare` takes them out.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from xml.etree import ElementTree

from orbisim.errors import SceneError
from orbisim.scene.safety import xmlsafe
from orbisim.scene.safety.problem import MeshProblemError
from orbisim.scene.safety.xmlsafe import Node

_LIMITS = xmlsafe.XmlLimits(nbytes=512 * 2**20)
_NO_NUMBER = re.compile(r"\S*[^\s\d.eE+-]\S*")
_PLAIN = "0.8 0.8 0.8 1"
_NOT_GEOMETRY = {
    "library_images",
    "library_cameras",
    "library_lights",
    "library_animations",
    "instance_camera",
    "instance_light",
    "extra",
}


@dataclasses.dataclass(frozen=True)
class Collada:
    """A document that is ready to be parsed.

    Attributes:
      document: XML without entities, textures and broken references to materials.
      metres: per unit of length.
      up_axis: as declared: `X_UP`, `Y_UP` or `Z_UP`.
      textured: whether there were textures.
    """

    document: bytes
    metres: float
    up_axis: str
    textured: bool


def prepare(path: Path) -> Collada:
    """Reads a COLLADA file.

    Raises:
      MeshProblemError: it is not COLLADA, or not safe XML.
    """
    try:
        root = xmlsafe.parse(path.read_bytes(), str(path), _LIMITS)
    except SceneError as error:
        raise MeshProblemError(f"is no COLLADA: {error.problem}") from None
    if _local(root) != "COLLADA":
        raise MeshProblemError(f"is no COLLADA: its root element is <{root.tag}>")
    metres, up_axis = _conventions(root)
    _check_positions(root)
    _remove(root, lambda node: _local(node) in _NOT_GEOMETRY)
    textured = _paint_over(root)
    _drop_broken_materials(root)
    return Collada(ElementTree.tostring(root, encoding="utf-8"), metres, up_axis, textured)


def _local(node: Node) -> str:
    return node.tag.rpartition(":")[2]


def _named(root: Node, tag: str) -> Iterator[Node]:
    return (node for node in root.descendants() if _local(node) == tag)


def _conventions(root: Node) -> tuple[float, str]:
    """Unit and up axis of the document; the asset elements of its parts do not count."""
    metres, up_axis = 1.0, "Y_UP"  # what COLLADA takes where nothing is declared
    asset = next((node for node in root.nodes() if _local(node) == "asset"), None)
    for node in asset.nodes() if asset is not None else ():
        if _local(node) == "unit":
            metres = _positive(node.get("meter", "1"))
        elif _local(node) == "up_axis":
            up_axis = (node.text or up_axis).strip()
    return metres, up_axis


def _check_positions(root: Node) -> None:
    """Refuses coordinates that are not finite, which parsers would replace by zero."""
    used = {
        node.get("source") for node in _named(root, "input") if node.get("semantic") == "POSITION"
    }
    for source in _named(root, "source"):
        if f"#{source.get('id')}" not in used:
            continue
        for array in source.nodes():
            strange = (
                _NO_NUMBER.search(array.text or "") if _local(array) == "float_array" else None
            )
            if strange:
                raise MeshProblemError(
                    f"has the coordinate {strange[0][:40]!r}, which is not finite"
                )


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise MeshProblemError(f"has the unit meter={text!r}; expected a positive number")
    return value


def _remove(root: Node, unwanted: Callable[[Node], bool]) -> None:
    """Removes the elements, below the root, for which `unwanted` holds."""
    for parent in list(root.descendants()):
        for child in parent.nodes():
            if unwanted(child):
                parent.remove(child)


def _paint_over(root: Node) -> bool:
    """Replaces textures by a plain colour; returns whether there were any."""
    textures = list(_named(root, "texture"))
    for texture in textures:
        texture.tag = texture.tag.removesuffix("texture") + "color"
        texture.attrib.clear()
        texture[:] = []
        texture.text = _PLAIN
    samplers = {"surface", "sampler2D"}
    _remove(
        root,
        lambda node: (
            _local(node) == "newparam" and any(_local(child) in samplers for child in node.nodes())
        ),
    )
    return bool(textures)


def _drop_broken_materials(root: Node) -> None:
    """Removes materials without their effect, and uses of materials that do not exist."""
    effects = {f"#{node.get('id')}" for node in _named(root, "effect")}
    _remove(
        root,
        lambda node: (
            _local(node) == "material"
            and any(_effect_of(child) not in (None, *effects) for child in node.nodes())
        ),
    )
    materials = {f"#{node.get('id')}" for node in _named(root, "material")}
    _remove(
        root,
        lambda node: _local(node) == "instance_material" and node.get("target") not in materials,
    )


def _effect_of(node: Node) -> str | None:
    return node.get("url") if _local(node) == "instance_effect" else None
