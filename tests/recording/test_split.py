"""What of long recordings is looked at."""

import numpy as np
import pytest

from orbisim.recording import Recording
from orbisim.recording.split import bounded, some_of


def test_of_ten_million_rows_a_search_sees_stretches_from_beginning_to_end() -> None:
    time = 1e-3 * np.arange(10_000_000)
    notes: list[str] = []
    pieces = bounded([Recording(time, {"qpos/a": time})], notes)
    assert sum(map(len, pieces)) <= 60_000
    assert pieces[0].time[0] == 0.0
    assert pieces[-1].time[-1] == pytest.approx(time[-1])
    assert max(np.diff([one.time[0] for one in pieces])) < 2 * time[-1] / len(pieces)
    assert "of 10000000 rows" in notes[0]


def test_of_many_short_recordings_some_are_used() -> None:
    time = np.linspace(0.0, 0.7, 50)
    many = [Recording(time, {"qpos/a": time}, source=f"{i}") for i in range(300)]
    notes: list[str] = []
    some = some_of(many, 0.5, 40, notes)
    assert [one.source for one in (some[0], some[-1])] == ["0", "299"]
    assert len(some) == 40 and "300 recordings, 40" in notes[0]
    long = [Recording(50 * time, {"qpos/a": time}) for _ in range(10)]
    assert some_of(long, 0.5, 40, []) == long  # each is as good as many
