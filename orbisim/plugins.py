"""Plug-ins: what installed packages offer under entry points, found by group and name.

A package offers its own with

    [project.entry-points."orbisim.backends"]
    mine = "my_package:MyBackend"

The groups are `orbisim.backends`, `orbisim.renderers`, `orbisim.readers` (scene formats, named by
suffix), `orbisim.recordings` (log formats, by suffix, too), `orbisim.scenes` and
`orbisim.episodes` (names such as `suite:cheetah-run`, by their prefix), `orbisim.texts` (what a
scene carries in `<custom><text>`), `orbisim.effects` and `orbisim.reports`. What OrbiSim brings
along is found in the same way.
"""

from __future__ import annotations

import functools
from importlib import metadata
from typing import Any

from orbisim.errors import MissingDependencyError, UnknownNameError, missing_module
from orbisim.host.progress import patient

EXTRAS = {
    "warp": "warp",
    "learned": "learned",
    "hybrid": "learned",
    "diffusion": "learned",
    "urdf": "urdf",
    "usd": "usd",
    "usda": "usd",
    "usdc": "usd",
    "usdz": "usd",
    "h5": "logs",
    "hdf5": "logs",
    "bag": "logs",
    "db3": "logs",
    "mcap": "logs",
    "metadata.yaml": "logs",
}
"""The extra that installs what OrbiSim's own plug-ins need, where they need one."""


@functools.cache
def _entry_points(group: str) -> dict[str, metadata.EntryPoint]:
    return {entry.name: entry for entry in metadata.entry_points(group=group)}


def names(group: str) -> tuple[str, ...]:
    """Names of the plug-ins of a group (their dependencies may still be missing)."""
    return tuple(_entry_points(group))


def load(group: str, name: str, kind: str) -> Any:
    """The object that a plug-in's entry point names.

    Args:
      group: of the entry point. name: of the plug-in.
      kind: what errors call it ("backend").

    Raises:
      UnknownNameError: there is none of this name.
      MissingDependencyError: its packages are not installed.
    """
    entries = _entry_points(group)
    if name not in entries:
        raise UnknownNameError(kind, name, entries)
    try:
        with patient(f"loading {kind} {name!r}"):  # what it imports, PyTorch say, may take a while
            return entries[name].load()
    except MissingDependencyError as error:
        extra = EXTRAS.get(name, error.extra)
        raise MissingDependencyError(
            f"{kind} {name!r}", extra, error.cause, error.command
        ) from error
    except ImportError as error:
        raise missing_module(f"{kind} {name!r}", error, EXTRAS.get(name, "all")) from error
