"""The files that a scene document refers to, found and read."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import mujoco

from orbisim.errors import SceneError
from orbisim.scene.safety.confine import resolve_inside


def contents(path: Path) -> bytes:
    """The bytes of a file.

    Raises:
      SceneError: it cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise SceneError(str(path), f"cannot be read: {error.strerror or error}") from None


@dataclasses.dataclass(frozen=True)
class FileReference:
    """One place in a document that names a file.

    Attributes:
      label: tag and name of the element.
      element: the spec's element.
      attribute: its field.
      index: in the field, where that is a list.
      directory: `meshdir` or `texturedir` of the document that the element came from.
      attached: whether that was another document than the main one.
    """

    label: str
    element: Any
    attribute: str
    index: int | None
    directory: str
    attached: bool

    @property
    def name(self) -> str:
        """The name as written."""
        value = getattr(self.element, self.attribute)
        return str(value if self.index is None else value[self.index])

    def rename(self, name: str) -> None:
        """Writes another name."""
        if self.index is None:
            setattr(self.element, self.attribute, name)
        else:
            getattr(self.element, self.attribute)[self.index] = name


def file_references(spec: mujoco.MjSpec) -> Iterator[FileReference]:
    """Every mesh, height field, skin and texture that is read from a file."""
    for tag, elements, directory in (
        ("mesh", spec.meshes, "meshdir"),
        ("hfield", spec.hfields, "meshdir"),
        ("skin", spec.skins, "meshdir"),
        ("texture", spec.textures, "texturedir"),
    ):
        for element in elements:
            label = f"{tag} {element.name!r}"
            compiler = getattr(element, "compiler", spec.compiler)
            place = (getattr(compiler, directory), compiler is not spec.compiler)
            if element.file:
                yield FileReference(label, element, "file", None, *place)
            for index, name in enumerate(getattr(element, "cubefiles", ())):
                if name:
                    yield FileReference(label, element, "cubefiles", index, *place)


def locate(reference: FileReference, folders: Sequence[Path], source: str) -> Path | None:
    """The file that a reference stands for; None if it does not exist.

    An attached document's files are looked for in the last of the folders first, those of the
    main document in the first.

    Raises:
      SceneError: references are confined, and this one leads nowhere inside.
    """
    name, directory = reference.name, reference.directory
    relative = (
        f"{directory}/{name}" if directory else name,
        f"{directory}/{Path(name).name}",
        name,
    )
    spellings = (name,) if Path(name).is_absolute() else tuple(dict.fromkeys(relative))
    refused: SceneError | None = None
    for folder in reversed(folders) if reference.attached else folders:
        for spelling in spellings:
            try:
                path = resolve_inside(spelling, folder, source=source, element=reference.label)
                if path.is_file():
                    return path
            except SceneError as error:
                refused = refused or error
            except (OSError, ValueError):  # a name that no file can have
                continue
    if refused is not None:
        raise refused
    return None


def content(
    spec: mujoco.MjSpec, reference: FileReference, folders: Sequence[Path], source: str
) -> bytes:
    """The bytes that a reference stands for.

    Raises:
      SceneError: the file is neither among the spec's own assets nor on disk.
    """
    name, directory = reference.name, reference.directory
    for key in (f"{directory}/{name}" if directory else name, name, Path(name).name):
        if key in spec.assets:
            data: bytes = spec.assets[key]
            return data
    path = locate(reference, folders, source)
    if path is not None:
        return path.read_bytes()
    raise SceneError(
        source,
        f"the file {name!r} is gone",
        element=reference.label,
        remedy=f"it was expected at {folders[0] / directory / name}",
    )


def embed(spec: mujoco.MjSpec, folders: Sequence[Path], source: str) -> None:
    """Puts every file that a document refers to into its own assets, under names of their own.

    Afterwards the document compiles and can be saved without the files.

    Raises:
      SceneError: a file does not exist.
    """
    assets: dict[str, bytes] = {}
    for reference in list(file_references(spec)):
        data = content(spec, reference, folders, source)
        name = free_name(Path(reference.name).name, data, assets)
        assets[name] = data
        reference.rename(name)
        compiler = getattr(reference.element, "compiler", spec.compiler)
        compiler.meshdir = compiler.texturedir = ""
    spec.meshdir = spec.texturedir = spec.modelfiledir = ""
    spec.strippath = False
    spec.assets = assets


def free_name(name: str, data: bytes, written: dict[str, bytes]) -> str:
    """A file name that is new, or already stands for the same content."""
    stem, suffix = Path(name).stem, Path(name).suffix
    candidate, number = name, 1
    while candidate in written and written[candidate] != data:
        number += 1
        candidate = f"{stem}_{number}{suffix}"
    return candidate
