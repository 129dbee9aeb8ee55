"""What a recording was read from, told apart from what has the same name."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from pathlib import Path

from orbisim.files.checked import digest_of


def files_of(sources: Iterable[str]) -> list[str]:
    """What recordings, whole or stretches of some, were read from; each once."""
    return list(dict.fromkeys(_STRETCH.sub("", one) for one in sources))


_STRETCH = re.compile(r"\[\S+ s to \S+ s\]$")
"""As `orbisim.recording.split` names a part of a recording."""


def digest_of_source(name: str) -> str | None:
    """SHA-256 of a file, also where an episode of it is named (`log.h5#3`); of a folder that of the
    lines `sha256sum` writes of its files but films; None of what is neither."""
    try:
        place = Path(name)
        if not place.exists():
            place = Path(name.rpartition("#")[0] or name)
        if not place.is_dir():
            return digest_of(place)
        within = (path.relative_to(place).as_posix() for path in place.rglob("*") if path.is_file())
        kept = sorted(one for one in within if not one.endswith(_FILMS))
        lines = (f"{digest_of(place / one)}  ./{one}\n" for one in kept)
        return hashlib.sha256("".join(lines).encode()).hexdigest()
    except (OSError, ValueError):
        return None


_FILMS = (".mp4", ".avi", ".mkv")
"""Of a folder of recordings: nothing that is diagnosed is in them, and they are large."""
