"""Notes of several recordings, each said once."""

from __future__ import annotations

from collections.abc import Sequence

_MOST = 3
"""Of sources that are named."""


def merged(notes: Sequence[str]) -> list[str]:
    """Notes `SOURCE: text` that differ in their source alone become one, in their order."""
    sources: dict[str, list[str]] = {}
    for note in notes:
        source, mark, text = note.partition(": ")
        key, where = (text, source) if mark else (note, "")
        sources.setdefault(key, []).append(where)
    lines = []
    for text, found in sources.items():
        named = list(dict.fromkeys(one for one in found if one))
        if len(named) < 2:
            lines.append(f"{named[0]}: {text}" if named else text)
            continue
        more = f" and {len(named) - _MOST} more" if len(named) > _MOST else ""
        lines.append(f"{', '.join(named[:_MOST])}{more}: {text}")
    return lines
