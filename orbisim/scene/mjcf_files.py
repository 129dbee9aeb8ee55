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
from orbisim.files.guard import opened
from orbisim.scene.files import file_references, locate
from orbisim.scene.safety import xmlsafe
from orbisim.scene.safety.confine import confinement, resolve_inside
from orbisim.scene.safety.meshcheck import check_native_mesh
from orbisim.scene.safety.meshformats import CHECKED_WHOLE
from orbisim.scene.safety.xmlsafe import Node

_DOCUMENTS = ("include", "model")
_OPENED_EARLY = (*_DOCUMENTS, "flexcomp")
_MOST_DOCUMENTS = 1000
"""Of one scene, includes counted: the largest public ones have some dozens."""


def documents(path: Path) -> list[Path]:
    """The document, and those that it includes or attaches, theirs too.

    Where references are confined (see `orbisim.scene.safety.confine`), all of them are checked.

    Raises:
      SceneError: a confined document is not safe XML, or refers to something outside.
    """
    found, seen = [path], {path}
    for document in found:
        for node in _nodes(document):
            for file in _references(node, document, path.parent):
                if file in seen or not _is_file(file):
                    continue
                seen.add(file)
                opened(file)
                if node.tag in _DOCUMENTS:
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
        path = locate(reference, folders, source)
        if path is None or path in checked:
            continue  # what is missing, MuJoCo knows best
        checked.add(path)
        opened(path)
        is_mesh = reference.label.startswith("mesh") and not reference.element.content_type
        if not is_mesh or path.suffix.lower() not in CHECKED_WHOLE:
            continue  # and what is of another format
        found = check_native_mesh(path, source=source, element=reference.label)
        if found.several_objects:
            notes.append(
                f"{reference.label}: {path.name!r} holds several objects, of which MuJoCo reads "
                "the first; join them to keep all"
            )
    return tuple(notes)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that no file can have
        return False


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
