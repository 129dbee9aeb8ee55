"""Writes a scene as MJCF plus the files it needs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco

from orbisim.errors import SceneError

ASSETS_FOLDER = "assets"


def save_spec(spec: mujoco.MjSpec, folder: Path, filename: str, source: str) -> Path:
    """Writes `spec` to `folder/filename` and its files to `folder/assets`.

    Raises:
      SceneError: a file that the scene refers to is gone.
    """
    from orbisim.scene.scene import full_precision

    folder.mkdir(parents=True, exist_ok=True)
    written: dict[str, bytes] = {}
    for element, attribute, index, directory in _references(spec):
        name = _get(element, attribute, index)
        data = _content(spec, name, directory, source)
        target = _free_name(Path(name).name, data, written)
        written[target] = data
        _set(element, attribute, index, f"{ASSETS_FOLDER}/{target}")
    if written:
        (folder / ASSETS_FOLDER).mkdir(exist_ok=True)
        for target, data in written.items():
            (folder / ASSETS_FOLDER / target).write_bytes(data)
    spec.meshdir = spec.texturedir = ""
    spec.strippath = False
    spec.modelfiledir = str(folder.resolve())
    spec.compile()
    path = folder / filename
    with full_precision():
        path.write_text(spec.to_xml())
    return path


def _references(spec: mujoco.MjSpec) -> Iterator[tuple[Any, str, int | None, str]]:
    """Every place that names a file: element, attribute, index in a list, directory."""
    for mesh in spec.meshes:
        if mesh.file:
            yield mesh, "file", None, spec.meshdir
    for hfield in spec.hfields:
        if hfield.file:
            yield hfield, "file", None, spec.meshdir
    for skin in spec.skins:
        if skin.file:
            yield skin, "file", None, spec.meshdir
    for texture in spec.textures:
        if texture.file:
            yield texture, "file", None, spec.texturedir
        for index, name in enumerate(texture.cubefiles):
            if name:
                yield texture, "cubefiles", index, spec.texturedir


def _get(element: Any, attribute: str, index: int | None) -> str:
    value = getattr(element, attribute)
    return str(value if index is None else value[index])


def _set(element: Any, attribute: str, index: int | None, name: str) -> None:
    if index is None:
        setattr(element, attribute, name)
    else:
        getattr(element, attribute)[index] = name


def _content(spec: mujoco.MjSpec, name: str, directory: str, source: str) -> bytes:
    bare = Path(name).name
    candidates = [name, bare, f"{directory}/{name}" if directory else name]
    for candidate in candidates:
        if candidate in spec.assets:
            data: bytes = spec.assets[candidate]
            return data
    base = Path(spec.modelfiledir or ".")
    for path in (base / directory / name, base / directory / bare, base / name):
        if path.is_file():
            return path.read_bytes()
    raise SceneError(
        source, f"the file {name!r} is gone", remedy=f"it was expected at {base / directory / name}"
    )


def _free_name(name: str, data: bytes, written: dict[str, bytes]) -> str:
    """A file name that is new, or already stands for the same content."""
    stem, suffix = Path(name).stem, Path(name).suffix
    candidate, number = name, 1
    while candidate in written and written[candidate] != data:
        number += 1
        candidate = f"{stem}_{number}{suffix}"
    return candidate
