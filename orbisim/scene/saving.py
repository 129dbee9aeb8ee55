"""Writes a scene as MJCF plus the files it needs."""

from __future__ import annotations

import warnings
from pathlib import Path

import mujoco

from orbisim.files.writing import make_folder, write_bytes, write_text
from orbisim.scene.files import embed, file_references
from orbisim.scene.mjcf_files import documents
from orbisim.scene.precision import full_precision

ASSETS_FOLDER = "assets"


def save_spec(spec: mujoco.MjSpec, folder: Path, filename: str, source: str) -> Path:
    """Writes `spec` to `folder/filename` and its files to `folder/assets`.

    Raises:
      SceneError: a file that the scene refers to is gone.
    """
    make_folder(folder)
    written: dict[str, bytes] = {}
    embed(spec, _folders(spec, source), source)
    for reference in list(file_references(spec)):
        target = reference.name
        written[target] = spec.assets[target]
        reference.rename(f"{ASSETS_FOLDER}/{target}")
    if written:
        make_folder(folder / ASSETS_FOLDER)
        for target, data in written.items():
            write_bytes(folder / ASSETS_FOLDER / target, data, announce=False)
    spec.modelfiledir = str(folder.resolve())
    path = folder / filename
    with full_precision(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # given when the scene was loaded
        spec.compile()
        write_text(path, spec.to_xml())
    return path


def packed(spec: mujoco.MjSpec, source: str) -> tuple[str, dict[str, bytes]]:
    """A document and the contents of the files that it refers to.

    Raises:
      SceneError: a file that the scene refers to is gone.
    """
    embed(spec, _folders(spec, source), source)
    with full_precision(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # given when the scene was loaded
        spec.compile()
        return str(spec.to_xml()), dict(spec.assets)


def unpacked(xml: str, assets: dict[str, bytes]) -> mujoco.MjSpec:
    """The document that `packed` was given."""
    return mujoco.MjSpec.from_string(xml, assets=assets)


def _folders(spec: mujoco.MjSpec, source: str) -> list[Path]:
    """Folders of the document and of those that it includes or attaches."""
    folders = [Path(spec.modelfiledir or ".")]
    main = Path(source)
    if main.suffix.lower() in (".xml", ".mjcf") and main.is_file():
        folders += [document.parent for document in documents(main)]
    return list(dict.fromkeys(folders))
