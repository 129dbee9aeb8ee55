"""The policies that come with the package."""

from __future__ import annotations

from pathlib import Path

from orbisim_policies.checkpoint import MANIFEST

FOLDER = Path(__file__).parent / "zoo"


def names() -> tuple[str, ...]:
    """Of the policies that there are."""
    return tuple(sorted(path.parent.name for path in FOLDER.glob(f"*/{MANIFEST}")))


def resolved(folder: str | Path) -> Path:
    """The folder; the zoo's policy of that name, if no folder of that name holds one."""
    path = Path(folder)
    return FOLDER / path if not (path / MANIFEST).exists() and str(folder) in names() else path
