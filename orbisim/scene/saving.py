"""Writes a scene as MJCF plus the files it needs."""

from __future__ import annotations

import warnings
from pathlib import Path

import mujoco

from orbisim.scene.files import embed, file_references
from orbisim.scene.mjcf_files import documents

ASSETS_FOLDER = "assets"


def save_spec(spec: mujoco.MjSpec, folder: Path, filename: str, source: str) -> Path:
    """Writes `spec` to `folder/filename` and its files to `folder/assets`.

    Raises:
      SceneError: a file that the scene refers to is gone.
    """
    from orbisim.scene.scene import full_precision

    folder.mkdir(parents=True, exist_ok=True)
    written: dict[str, bytes] = {}
    embed(spec, _folders(spec, source), source)
    for reference in list(file_references(spec)):
        target = reference.name
        written[target] = spec.assets[target]
        reference.rename(f"{ASSETS_FOLDER}/{target}")
    if written:
        (folder / ASSETS_FOLDER).mkdir(exist_ok=True)
        for target, data in written.items():
            (folder / ASSETS_FOLDER / target).write_bytes(data)
    spec.modelfiledir = str(folder.resolve())
    path = folder / filename
    with full_precision(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # given when the scene was loaded
        spec.compile()
        path.write_text(spec.to_xml())
    return path


def _folders(spec: mujoco.MjSpec, source: str) -> list[Path]:
    """Folders of the document and of those that it includes or attaches."""
    folders = [Path(spec.modelfiledir or ".")]
    main = Path(source)
    if main.suffix.lower() in (".xml", ".mjcf") and main.is_file():
        folders += [document.parent for document in documents(main)]
    return list(dict.fromkeys(folders))
