"""Keeps the references of a scene that came from an archive inside that archive.

A scene file on disk may refer to any file that its user can read. A scene that came in an archive
may refer only to files of that archive: `confined_to` marks the folder it was extracted to, and
every reader asks `resolve_inside` before it opens a file that the scene names.
"""

from __future__ import annotations

import contextlib
import contextvars
import os
import re
from collections.abc import Iterator
from pathlib import Path

from orbisim.errors import SceneError

_ROOT: contextvars.ContextVar[Path | None] = contextvars.ContextVar("confined_to", default=None)
_DRIVE = re.compile(r"^[A-Za-z]:")


@contextlib.contextmanager
def confined_to(folder: Path) -> Iterator[None]:
    """Within the block, `confinement()` is this folder."""
    token = _ROOT.set(folder.resolve())
    try:
        yield
    finally:
        _ROOT.reset(token)


def confinement() -> Path | None:
    """The folder that references must stay in, or None where they are free."""
    return _ROOT.get()


def resolve_inside(reference: str, base: Path, *, source: str, element: str) -> Path:
    """The path of a file that a scene names, relative to `base`.

    Raises:
      SceneError: references are confined, and this one is absolute or leaves the folder.
    """
    root = confinement()
    if root is None:
        return base / reference
    remedy = "refer to a file inside the archive by a relative path"
    local = reference.replace("\\", "/")
    absolute = local.startswith(("/", "~")) or _DRIVE.match(local) or "://" in local
    if absolute and not Path(local).resolve().is_relative_to(root):  # parsers make some absolute
        raise SceneError(
            source, f"refers to {reference!r}, an absolute path", element=element, remedy=remedy
        )
    path = Path(os.path.normpath(base.resolve() / local))
    if not path.is_relative_to(root) or not path.resolve().is_relative_to(root):
        raise SceneError(
            source, f"refers to {reference!r}, outside the archive", element=element, remedy=remedy
        )
    return path
