"""Which recordings, or stretches of them, no choice and no fit may see."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orbisim.errors import InputError
from orbisim.recording import Recording

_SHARE = 0.25
"""Of the data that no fit sees."""
_MOST_ROWS = 60_000
"""Beyond them a fit becomes slower and hardly any surer: rows after one another are alike."""


def split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Recordings to fit, and recordings to hold back.

    Of four recordings or more, about every fourth is held back; of fewer, the last quarter of each.

    Raises:
      InputError: they are too short to keep anything back.
    """
    every = list(recordings)
    if len(every) >= 4:
        count = round(_SHARE * len(every))
        chosen = {round((i + 1) * len(every) / count) - 1 for i in range(count)}
        return (
            [one for i, one in enumerate(every) if i not in chosen],
            [one for i, one in enumerate(every) if i in chosen],
        )
    fit, held = [], []
    for one in every:
        border = round((1 - _SHARE) * len(one))
        if border < 8 or len(one) - border < 4:
            fit.append(one)
            continue
        fit.append(_stretch(one, slice(0, border)))
        held.append(_stretch(one, slice(border, len(one))))
    if not held:
        raise InputError(
            f"{', '.join(one.source for one in every)}: too short to keep anything back "
            "(at least 12 samples); record more, or name recordings to hold out"
        )
    return fit, held


def some_of(
    recordings: Sequence[Recording], window: float, windows: int, notes: list[str]
) -> list[Recording]:
    """Of many short recordings so many, spread evenly, as hold so many windows: no search looks at
    more, and each takes time to smooth.

    Args:
      window: duration, s. notes: gets a line if any are left out.
    """
    every = list(recordings)
    held = [max(1, int((one.time[-1] - one.time[0]) / window)) for one in every]
    count = max(_FEWEST, int(np.ceil(len(every) * windows / sum(held))))
    if count >= len(every):
        return every
    notes.append(f"of {len(every)} recordings, {count} are used, spread evenly over them")
    return [every[i] for i in np.linspace(0, len(every) - 1, count).round().astype(int)]


_FEWEST = 12
"""Recordings that are never too many."""


def bounded(recordings: Sequence[Recording], notes: list[str]) -> list[Recording]:
    """At most so many rows in all: stretches spread evenly over long recordings."""
    total = sum(len(one) for one in recordings)
    if total <= _MOST_ROWS:
        return list(recordings)
    notes.append(
        f"of {total} rows, {_MOST_ROWS} are used, in stretches spread evenly over the recordings"
    )
    found: list[Recording] = []
    for one in recordings:
        rows = max(8, int(_MOST_ROWS * len(one) / total))
        pieces = max(1, rows // _STRETCH)
        each = max(8, rows // pieces)
        for start in np.linspace(0, len(one) - each, pieces).astype(int):
            found.append(_stretch(one, slice(int(start), int(start) + each)))
    return found


_STRETCH = 2_000
"""Rows of a piece, in which slow motions still show: two seconds at 1 kHz."""


def _stretch(one: Recording, rows: slice) -> Recording:
    part = one.rows(rows)
    return part.replace(source=f"{one.source}[{part.time[0]:.6g} s to {part.time[-1]:.6g} s]")
