"""OrbiSim's own plug-ins by name where it is not installed but run from its source.

Entry points come with an installation. Where only the path to the source is known, `register()`
writes what an installation would say about them, from `pyproject.toml`, into a temporary folder on
Python's path.
"""

from __future__ import annotations

import atexit
import importlib
import os
import shutil
import sys
import tempfile
import tomllib
from importlib import metadata
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent


def register(*names: str) -> tuple[str, ...]:
    """Registers those names (all of them, if none is given) that are not known yet.

    A plug-in whose packages are missing is left out: asking for it is an error that names it.
    Gives the names of what is known then.
    """
    for path in (str(ROOT / "backends"), str(ROOT)):
        if path not in sys.path:
            sys.path.insert(0, path)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    _describe(project)
    from orbisim import registry

    known = {
        registry.BACKENDS: (registry.available_backends, registry.register_backend),
        registry.RENDERERS: (registry.available_renderers, registry.register_renderer),
    }
    for group, (available, add) in known.items():
        for name, where in project["entry-points"][group].items():
            if name in available() or (names and name not in names):
                continue
            module, _, attribute = where.partition(":")
            try:
                add(name, getattr(importlib.import_module(module), attribute))
            except ImportError:
                continue
    return (*registry.available_backends(), *registry.available_renderers())


def _describe(project: dict[str, Any]) -> None:
    """Makes entry points known where there is no installation: of readers, reports and so on."""
    try:
        metadata.distribution(project["name"])
    except metadata.PackageNotFoundError:
        folder = tempfile.mkdtemp(prefix="orbisim-entry-points-")
        atexit.register(_remove, folder, os.getpid())
        info = Path(folder) / f"{project['name']}-0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 0\n"
        )
        lines = []
        for group, entries in project["entry-points"].items():
            lines += [f"[{group}]", *(f"{name} = {where}" for name, where in entries.items()), ""]
        (info / "entry_points.txt").write_text("\n".join(lines))
        sys.path.append(folder)
        from orbisim import plugins

        for group in project["entry-points"]:  # they are kept: the folder is not read again
            plugins.names(group)


def _remove(folder: str, owner: int) -> None:
    """Removes the folder at the end of the process that has made it, not of its children."""
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)
