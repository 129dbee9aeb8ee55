"""What to collect."""

from __future__ import annotations

import dataclasses

import pytest

from orbisim.tasks import storage
from orbisim.tasks.frames import Camera
from orbisim.tasks.orders import Order

ORDER = Order("ball", {"velocity_x": 0.25}, 3, None, tuple(("throw", i) for i in range(40)))


def test_equal_orders_have_equal_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    key = ORDER.key
    assert dataclasses.replace(ORDER).key == key
    for change in (
        {"task": "toss"}, {"changes": {}}, {"seed": 4}, {"camera": Camera("side")},
        {"entries": ORDER.entries[:-1]},
    ):  # fmt: skip
        assert dataclasses.replace(ORDER, **change).key != key, change
    monkeypatch.setattr(storage, "versions", lambda: {"orbisim": "9"})
    assert ORDER.key != key


@pytest.mark.parametrize("count", [1, 15, 16, 17, 40])
def test_chunks_hold_every_episode_once(count: int) -> None:
    chunks = dataclasses.replace(ORDER, entries=ORDER.entries[:count]).chunks()
    assert [number for chunk in chunks for number in chunk] == list(range(count))
    assert all(len(chunk) == 16 for chunk in chunks[:-1])
