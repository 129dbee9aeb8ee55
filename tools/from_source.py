"""OrbiSim's own backends and renderers by name where it is not installed but run from its source.

Entry points come with an installation. Where only the path to the source is known, `register()`
reads them from `pyproject.toml` instead.
"""

from __future__ import annotations

import importlib
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def register(*names: str) -> tuple[str, ...]:
    """Registers those names (all of them, if none is given) that are not known yet.

    A plug-in whose packages are missing is left out: asking for it is an error that names it.
    Gives the names of what is known then.
    """
    for path in (str(ROOT / "backends"), str(ROOT)):
        if path not in sys.path:
            sys.path.insert(0, path)
    from orbisim import registry

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
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
