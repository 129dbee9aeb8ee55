"""Visual meshes whose files are not there: left out, and said."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from orbisim.scene.safety.meshformats import is_lfs_pointer
from orbisim.scene.urdf.model import Link, Robot, Shape
from orbisim.scene.urdf.packages import FileFinder, MissingFileError


def without_missing_visuals(robot: Robot, finder: FileFinder) -> Robot:
    """The robot without visual meshes that cannot be found; collision meshes are needed.

    Raises:
      SceneError: a file lies outside the archive that the document came in, or on the network.
    """
    notes: list[str] = []
    links = {name: _seen(link, finder, notes) for name, link in robot.links.items()}
    return dataclasses.replace(robot, links=links, warnings=(*robot.warnings, *notes))


def _seen(link: Link, finder: FileFinder, notes: list[str]) -> Link:
    return dataclasses.replace(link, visuals=tuple(_present(link, finder, notes)))


def _present(link: Link, finder: FileFinder, notes: list[str]) -> Iterator[Shape]:
    for shape in link.visuals:
        problem = _problem(shape, finder) if shape.kind == "mesh" else None
        if problem is None:
            yield shape
        else:
            notes.append(f"{shape.label} is left out: {problem}")


def _problem(shape: Shape, finder: FileFinder) -> str | None:
    """Why a mesh cannot be drawn; None if it can."""
    try:
        path = finder.find(shape.file, shape.label)
    except MissingFileError as error:
        return f"{error.problem}; {error.remedy}"
    if is_lfs_pointer(path):
        return f"{path.name!r} is a Git LFS pointer; run git lfs pull in its repository"
    return None
