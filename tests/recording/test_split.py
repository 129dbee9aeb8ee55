"""What of long recordings is looked at."""

import numpy as np
import pytest

from orbisim.recording import Recording
from orbisim.recording.split import bounded


def test_of_ten_million_rows_a_search_sees_stretches_from_beginning_to_end() -> None:
    time = 1e-3 * np.arange(10_000_000)
    notes: list[str] = []
    pieces = bounded([Recording(time, {"qpos/a": time})], notes)
    assert sum(map(len, pieces)) <= 60_000
    assert pieces[0].time[0] == 0.0
    assert pieces[-1].time[-1] == pytest.approx(time[-1])
    assert max(np.diff([one.time[0] for one in pieces])) < 2 * time[-1] / len(pieces)
    assert "of 10000000 rows" in notes[0]
