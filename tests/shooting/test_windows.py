"""How recordings are cut into windows."""

from __future__ import annotations

import numpy as np

from orbisim.shooting.windows import cut_windows


def cut(*lengths: int) -> list[tuple[int, int]]:
    """Recording and first interval of windows of ten intervals."""
    recording = np.repeat(np.arange(len(lengths)), lengths)
    row = np.concatenate([np.arange(n) for n in lengths])
    found = cut_windows(recording, row, 10)
    return [(int(recording[f]), int(row[f])) for f in found.first]


def test_windows_of_one_recording_each() -> None:
    assert cut(20, 10) == [(0, 0), (0, 10), (1, 0)]
    assert cut(17) == [(0, 0), (0, 7)]  # the last overlaps the one before
    assert cut(13) == [(0, 0)]  # hardly anything would be new


def test_a_recording_shorter_than_a_window_has_none() -> None:
    """Beside longer ones: no window reaches into the recording before."""
    assert cut(20, 7, 20) == [(0, 0), (0, 10), (2, 0), (2, 10)]
    assert cut(7) == []
