"""Where the files of a URDF document are: packages, URLs, relative paths."""

from __future__ import annotations

import functools
import os
import re
import urllib.parse
from collections.abc import Iterator
from pathlib import Path

from orbisim.errors import SceneError
from orbisim.scene.safety import xmlsafe
from orbisim.scene.safety.confine import confinement, resolve_inside
from orbisim.scene.urdf.options import UrdfOptions

_PACKAGE = re.compile(r"^(?:package|model)://([^/]*)/?(.*)$|^\$\(find ([^)]+)\)/?(.*)$")
_SCHEME = re.compile(r"^([A-Za-z][A-Za-z0-9+.-]+):")
_CRAWL_DEPTH = 3
"""Folders down: where a workspace keeps its packages (workspace/src/collection/package)."""
_CRAWL_FOLDERS = 2000
"""Folders looked at, so that a search from a home folder ends."""


class MissingFileError(SceneError):
    """A file, or the package that it is said to be in, is not there."""


class FileFinder:
    """Finds the files that a document names.

    Args:
      folder: where the document is; None for a document without a place, whose relative names
        count from the working directory.
      meshdir: folder for relative names, from MuJoCo's extension of URDF. Names that contain the
        folder already, as many exporters write them, are found as well: `meshdir/name`, `name` and
        `meshdir/` with the last part of the name are tried.
      strippath: whether only the last part of a name counts, from that extension.
    """

    def __init__(
        self,
        folder: Path | None,
        options: UrdfOptions,
        source: str,
        *,
        meshdir: str = "",
        strippath: bool = False,
    ) -> None:
        self._folder = (folder or Path()).resolve()
        self._base = self._folder / meshdir
        self._options, self._source, self._strip = options, source, strippath

    def find(self, name: str, element: str) -> Path:
        """The file that `name` stands for.

        Raises:
          SceneError: there is none, its package is not found, it is on the network, or it lies
            outside the archive that the document came in.
        """
        if self._strip:
            name = re.split(r"[/\\]", name)[-1]
        package = _PACKAGE.match(name)
        if package:
            return self._in_package(
                package[1] or package[3] or "", package[2] or package[4], element
            )
        if name.startswith("file:"):
            name = urllib.parse.unquote(re.sub(r"^file:(//(localhost)?(?=/)|//)?", "", name))
        elif (scheme := _SCHEME.match(name)) and "://" in name:
            raise self._error(
                element,
                f"{name!r} is on the network or of an unknown kind ({scheme[1]})",
                "name a file: package://, file:// or a path relative to the document",
            )
        places = list(dict.fromkeys(self._places(name)))
        for base, candidate in places:
            path = resolve_inside(candidate, base, source=self._source, element=element)
            if path.exists():
                return path
        base, candidate = places[0]
        raise self._missing(
            element, f"the file {name!r} does not exist", f"expected it at {base / candidate}"
        )

    def _places(self, name: str) -> Iterator[tuple[Path, str]]:
        """Where a relative name may lead, best first: folder, and name in it."""
        plain = name.replace("\\", "/")
        for candidate in (name, plain):
            yield self._base, candidate
        if self._base != self._folder:
            yield self._folder, plain
            yield self._base, plain.rpartition("/")[2]

    def _in_package(self, package: str, name: str, element: str) -> Path:
        known: list[Path] = []
        for folder in dict.fromkeys(self._package_folders(package)):
            path = self._inside(folder / name, folder, name, element)
            if path is None:
                continue
            if path.exists():
                return path
            known.append(folder)
        if known:
            raise self._missing(
                element,
                f"package {package!r} has no file {name!r}",
                f"looked in {', '.join(str(folder) for folder in known[:4])}",
            )
        raise self._missing(
            element,
            f"the package {package!r} is not found",
            f"name its folder: --package {package}=FOLDER (in Python package_paths="
            f"{{{package!r}: FOLDER}}), or set ROS_PACKAGE_PATH to the folder that holds it",
        )

    def _inside(self, path: Path, folder: Path, name: str, element: str) -> Path | None:
        """The path; None where a confined document may not go; an error where it tries to."""
        root = confinement()
        if root is None or folder in self._trusted():
            return path
        if not folder.resolve().is_relative_to(root):
            return None
        return resolve_inside(name, folder, source=self._source, element=element)

    def _trusted(self) -> tuple[Path, ...]:
        """Folders that the user named: a document from an archive may use them too."""
        named = self._options.named_packages.values()
        return (*named, *self._options.package_folders)

    def _package_folders(self, package: str) -> Iterator[Path]:
        """Folders that may be the package, best first."""
        options = self._options
        if package in options.named_packages:
            yield options.named_packages[package]
        for folder in options.package_folders:
            yield from _packages_at(folder, package)
        if confinement() is None:
            for folder in _environment("ROS_PACKAGE_PATH"):
                yield from _packages_at(folder, package)
            for folder in _environment("AMENT_PREFIX_PATH"):
                yield from _existing(folder / "share" / package)
        for folder in (self._folder, *self._folder.parents):
            if folder.name == package or _package_name(folder) == package:
                yield folder
            yield from _existing(folder / package)
        if confinement() is None:
            for folder in _environment("ROS_PACKAGE_PATH"):
                yield from _crawl(folder, package)

    def _missing(self, element: str, problem: str, remedy: str) -> MissingFileError:
        return MissingFileError(self._source, problem, element=element, remedy=remedy)

    def _error(self, element: str, problem: str, remedy: str) -> SceneError:
        return SceneError(self._source, problem, element=element, remedy=remedy)


def _environment(variable: str) -> Iterator[Path]:
    return (Path(entry) for entry in os.environ.get(variable, "").split(os.pathsep) if entry)


def _packages_at(folder: Path, package: str) -> Iterator[Path]:
    """The folder itself if it is the package, or the package inside it."""
    if folder.name == package or _package_name(folder) == package:
        yield folder
    yield from _existing(folder / package)


def _existing(folder: Path) -> Iterator[Path]:
    if folder.is_dir():
        yield folder


def _crawl(folder: Path, package: str) -> Iterator[Path]:
    """Packages below a folder, as ROS finds them: by their package.xml."""
    level = [folder]
    seen = 0
    for _ in range(_CRAWL_DEPTH):
        below: list[Path] = []
        for entry in level:
            if entry.is_dir():
                below += [path for path in sorted(entry.iterdir()) if path.is_dir()]
        seen += len(below)
        if seen > _CRAWL_FOLDERS:
            return
        yield from (path for path in below if _package_name(path) == package)
        level = below


@functools.lru_cache(maxsize=4096)
def _package_name(folder: Path) -> str | None:
    """The name in a folder's package.xml; None if there is no such file."""
    file = folder / "package.xml"
    try:
        root = xmlsafe.parse(file.read_bytes(), str(file))
    except (OSError, SceneError):
        return None
    name = root.child("name")
    return (name.text or "").strip() if name is not None else None
