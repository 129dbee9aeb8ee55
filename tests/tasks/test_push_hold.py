"""`task:push_hold`: rest rests, holding holds, shaken starts come to rest, strokes push."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import tasks
from orbisim.tasks.episode import Episode


def _episode(subtask: str, seed: int = 3, steps: int = 120) -> Episode:
    return tasks.make("push_hold", steps=steps).episode(subtask, seed)


def test_rest_rests() -> None:
    qpos = _episode("rest", steps=30).arrays["qpos"]
    assert np.abs(qpos - qpos[0]).max() < 2e-4


def test_motion_that_ends_is_held() -> None:
    episode = _episode("hold", steps=200)
    ctrl, qpos = episode.arrays["ctrl"], episode.arrays["qpos"]
    assert np.abs(ctrl - ctrl[0]).max() > 0.05
    assert np.abs(ctrl[-1] - ctrl[-40]).max() < 1e-5
    assert np.abs(qpos[-1, :6] - ctrl[-1, :6]).max() < 1e-3


def test_shaken_starts_differ_in_size_and_come_to_rest() -> None:
    moved = []
    for seed in range(4):
        arrays = _episode("shaken", seed, steps=60).arrays
        moved.append(np.abs(arrays["qpos"][0, :6] - arrays["ctrl"][0, :6]).max())
        assert np.abs(arrays["qvel"][0]).max() > 0
        assert np.isfinite(arrays["qpos"]).all()
    assert max(moved) > 3 * min(moved)


def test_strokes_go_on() -> None:
    arrays = _episode("strokes", steps=200).arrays
    first, last = arrays["qpos"][[0, -1], 8:]
    assert np.abs(last - first).max() > 0.02
    assert np.abs(np.diff(arrays["ctrl"][-60:], axis=0)).max() > 1e-3


@pytest.mark.parametrize("subtask", ["roam", "strokes"])
def test_the_same_seed_gives_the_same_episode(subtask: str) -> None:
    a, b = (_episode(subtask, steps=20) for _ in range(2))
    assert all(np.array_equal(a.arrays[name], b.arrays[name]) for name in a.arrays)
