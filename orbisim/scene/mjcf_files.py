"""The files of an MJCF document, checked before MuJoCo opens them.

What a document includes or attaches is read while it is parsed, so a document from an archive has
its references checked first, as text (`documents`). Its meshes are read when it is compiled, and
are checked in between (`check_meshes`).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco

from orbisim.errors import SceneError
from orbisim.scene import xmlsafe
from orbisim.scene.confine import confinement, resolve_inside
from orbisim.scene.files import file_references, locate
from orbisim.scene.meshformats import obj_has_several_objects
from orbisim.scene.xmlsafe import Node

_DOCUMENTS = ("include", "model")
_OPENED_EARLY = (*_DOCUMENTS, "flexcomp")
_MOST_DOCUMENTS = 1000
_NATIVE = (".stl", ".obj", ".msh")
"""Mesh formats that MuJoCo itself decodes; what else there is comes from its plugins."""


def documents(path: Path) -> list[Path]:
    """The document, and those that it includes or attaches, theirs too.

    Where references are confined (see `orbisim.scene.confine`), all of them are checked.

    Raises:
      SceneError: a confined document is not safe XML, or refers to something outside.
    """
    found = [path]
    for document in found:
        for node in _nodes(document):
            for file in _references(node, document, path.parent):
                is_document = node.tag in _DOCUMENTS
                if is_document and file.is_file() and file not in found:
                    found.append(file)
        if len(found) > _MOST_DOCUMENTS:
            raise SceneError(str(path), f"includes more than {_MOST_DOCUMENTS} documents")
    return found


def check_meshes(spec: mujoco.MjSpec, folders: Sequence[Path], source: str) -> tuple[str, ...]:
    """Checks every mesh file of a parsed document; returns what MuJoCo reads only in part.

    Args:
      folders: of the document and of those it includes or attaches, in that order.

    Raises:
      SceneError: a mesh file is broken or hostile.
    """
    checked: set[Path] = set()
    notes: list[str] = []
    for reference in file_references(spec):
        if not reference.label.startswith("mesh") or reference.element.content_type:
            continue
        path = locate(reference, folders, source)
        if path is None or path in checked or path.suffix.lower() not in _NATIVE:
            continue  # what is missing or of another format, MuJoCo knows best
        from orbisim.scene.meshes import check_mesh_file  # trimesh takes most of a second

        check_mesh_file(path, source=source, element=reference.label)
        checked.add(path)
        if path.suffix.lower() == ".obj" and obj_has_several_objects(path.read_bytes()):
            notes.append(
                f"{reference.label}: {path.name!r} holds several objects, of which MuJoCo reads "
                "the first; join them to keep all"
            )
    return tuple(notes)


def _nodes(document: Path) -> list[Node]:
    """The elements of a document; none where free, and MuJoCo may read what expat does not."""
    try:
        return list(xmlsafe.parse(document.read_bytes(), str(document)).descendants())
    except (SceneError, OSError):
        if confinement() is not None:
            raise
        return []


def _references(node: Node, document: Path, main: Path) -> list[Path]:
    """Documents that an element names, as MuJoCo may resolve them.

    Other files are opened when the scene is compiled, by names that `orbisim.scene.files` has
    checked. Folders, and the meshes of flexible objects, which are opened early, are checked here.
    """
    names = [
        (name, value)
        for name, value in node.attrib.items()
        if value and (name.endswith("dir") or (name == "file" and node.tag in _OPENED_EARLY))
    ]
    return [
        resolve_inside(value, folder, source=str(document), element=f"{node.label()}, {name}")
        for name, value in names
        for folder in dict.fromkeys((document.parent, main))
    ]
