"""`<mujoco>` in a URDF document: MuJoCo's own extension, with compiler, option and size."""

from __future__ import annotations

import dataclasses
from xml.etree import ElementTree

import mujoco

from orbisim.errors import SceneError
from orbisim.scene.mjcf import COMPILER_ERRORS, as_scene_error
from orbisim.scene.reading import Unsupported
from orbisim.scene.safety.xmlsafe import Node

_SECTIONS = ("compiler", "option", "size")


@dataclasses.dataclass(frozen=True)
class Extension:
    """What the extension asks for.

    Attributes:
      spec: an empty model with the extension's settings.
      meshdir, strippath: how names of mesh files are to be read.
      fusestatic, discardvisual: MuJoCo's import has both on unless the extension says otherwise.
      unsupported: sections that the extension may not have.
    """

    spec: mujoco.MjSpec
    meshdir: str
    strippath: bool
    fusestatic: bool
    discardvisual: bool | None
    unsupported: tuple[Unsupported, ...]


def read_extension(node: Node | None, name: str, source: str) -> Extension:
    """Reads the extension; `node` is None where a document has none.

    Raises:
      SceneError: MuJoCo refuses a setting.
    """
    root = ElementTree.Element("mujoco", {"model": name})
    sections = node.nodes() if node is not None else []
    root.extend(section for section in sections if section.tag in _SECTIONS)
    try:
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
    except COMPILER_ERRORS as error:
        plain = as_scene_error(error, source)
        raise SceneError(source, plain.problem, element="the <mujoco> extension") from None
    compiler = node.child("compiler") if node is not None else None
    settings = compiler.attrib if compiler is not None else {}
    discard = settings.get("discardvisual")
    spec.compiler.degree = False
    # the reader itself lumps links, drops visual geometry and finds files
    spec.compiler.fusestatic = spec.compiler.discardvisual = False
    spec.meshdir = spec.texturedir = spec.modelfiledir = ""
    spec.strippath = False
    return Extension(
        spec=spec,
        meshdir=settings.get("meshdir") or settings.get("assetdir") or "",
        strippath=settings.get("strippath") == "true",
        fusestatic=settings.get("fusestatic", "true") == "true",
        discardvisual=None if discard is None else discard == "true",
        unsupported=tuple(
            Unsupported(
                f"<{s.tag}> in <mujoco> (line {s.line})", "no part of the extension", "ignored"
            )
            for s in sections
            if s.tag not in _SECTIONS
        ),
    )
