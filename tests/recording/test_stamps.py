"""Stamps of a host about the grid of a controller."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import Recording
from orbisim.recording.stamps import grid_of, regular


def late(time: np.ndarray, seed: int = 0) -> np.ndarray:
    """What a host with a bus writes: 2 ms late on average, with a tail."""
    arrived = time + np.random.default_rng(seed).gamma(2.0, 0.001, len(time))
    return np.maximum.accumulate(arrived) + 1e-9 * np.arange(len(time))


@pytest.mark.parametrize("rate", [100.0, 200.0])
@pytest.mark.parametrize("count", [300, 3000])
def test_the_grid_is_found_but_for_the_mean_delay(rate: float, count: int) -> None:
    time = np.arange(count) / rate
    grid = grid_of(late(time))
    assert grid is not None
    assert np.abs(grid - 0.002 - time).max() < 5e-4


def test_missing_samples_leave_gaps_in_it() -> None:
    time = np.arange(500) / 100.0
    kept = np.random.default_rng(1).random(500) > 0.03
    kept[200:208] = False
    grid = grid_of(late(time)[kept])
    assert grid is not None
    off = np.abs(grid - 0.002 - time[kept])
    assert np.mean(off < 5e-4) > 0.99
    assert off.max() < 1.1 / 100.0  # what comes late beside a gap may be taken for its neighbour


@pytest.mark.parametrize(
    "time",
    [
        np.arange(500) / 100.0,
        np.round(np.arange(500) / 60.0, 6),
        np.delete(np.arange(500) / 100.0, [7, 100, 101, 102]),
        np.sort(np.random.default_rng(2).uniform(0, 5, 500)),
        np.arange(20) / 100.0 + 1e-3 * np.sin(np.arange(20)),
    ],
    ids=["a grid", "rounded", "a grid with gaps", "at random", "few"],
)
def test_there_is_none_to_take(time: np.ndarray) -> None:
    assert grid_of(time) is None


def swing(time: np.ndarray, stamps: np.ndarray) -> Recording:
    noise = 1e-4 * np.random.default_rng(3).normal(size=len(time))
    return Recording(stamps, {"qpos/hinge": np.sin(3 * time) + noise}, source="log")


def test_positions_that_are_smoother_on_the_grid_are_put_there() -> None:
    time = np.arange(600) / 100.0
    logged = swing(time, late(time))
    (found,), _ = regular([logged])
    assert np.abs(found.time - 0.002 - time).max() < 5e-4
    assert "time stamps scatter by 1.3 ms about samples every 10 ms" in found.notes[-1]
    assert np.array_equal(found["qpos/hinge"], logged["qpos/hinge"])


def test_true_stamps_of_irregular_samples_stay() -> None:
    time = late(np.arange(600) / 100.0)
    logged = swing(time, time)
    assert regular([logged])[0][0] is logged


def test_what_does_not_move_says_nothing_of_its_stamps() -> None:
    still = Recording(late(np.arange(600) / 100.0), {"qpos/hinge": np.zeros(600)}, source="log")
    assert regular([still])[0][0] is still


def test_recordings_of_a_machine_are_read_in_one_way() -> None:
    """One that hardly moves does not say; the others do, for it and for what is held out, too."""
    time = np.arange(600) / 100.0
    stamps = late(time)
    slow = Recording(stamps, {"qpos/hinge": 1e-3 * np.sin(time)}, source="slow")
    found, held = regular([swing(time, stamps), slow, swing(time, time)], [slow])
    assert np.array_equal(held[0].time, found[0].time)
    assert np.array_equal(found[0].time, found[1].time)
    assert np.array_equal(found[2].time, time)  # on a grid already


def test_one_logger_writes_all_recordings_of_a_machine() -> None:
    """Where most have no grid, one that has is chance, or another clock."""
    time = np.arange(600) / 100.0
    runs = [swing(time, late(time)), swing(time, time), swing(time, time)]
    assert all(a is b for a, b in zip(regular(runs)[0], runs, strict=True))
