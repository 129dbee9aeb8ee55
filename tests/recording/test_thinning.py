"""Thinning of recordings that are sampled much faster than a window needs."""

import copy
import pickle

import numpy as np
import pytest

from orbisim.recording import Recording
from orbisim.recording.thinning import MOST_SAMPLES, Thinned, thinned, usual_window

TIME = np.arange(0, 4, 1e-3)


def test_windows_have_at_most_so_many_samples() -> None:
    rng = np.random.default_rng(0)
    fast = Recording(
        TIME,
        {
            "qpos/a": np.sin(TIME),
            "ctrl/m": rng.normal(size=len(TIME)),
            "xpos/b": rng.normal(size=(len(TIME), 3)),
        },
    )
    notes: list[str] = []
    (slow,) = thinned([fast], 1.0, notes)
    assert 1.0 / np.diff(slow.time).mean() == pytest.approx(MOST_SAMPLES, rel=1e-6)
    assert np.array_equal(slow["qpos/a"], fast["qpos/a"][::5])
    assert slow["xpos/b"].shape == (len(slow), 3)
    assert slow["ctrl/m"][7] == pytest.approx(fast["ctrl/m"][35:40].mean())
    assert f"{len(slow)} of {len(fast)}" in notes[0]


@pytest.mark.parametrize(
    ("rate", "duration", "window"),
    [(200.0, 8.0, 0.5), (60.0, 8.0, 0.5), (30.0, 18.0, 2.0), (10.0, 60.0, 6.0), (10.0, 9.0, 3.0)],
)
def test_slow_recordings_have_longer_windows(rate: float, duration: float, window: float) -> None:
    time = np.arange(0, duration + 1e-9, 1 / rate)
    run = Recording(time=time, signals={"qpos/x": np.sin(time)})
    assert usual_window([run]) == pytest.approx(window)


def test_missing_controls_stay_missing() -> None:
    control = np.ones(len(TIME))
    control[12] = np.nan
    (slow,) = thinned([Recording(TIME, {"qpos/a": TIME, "ctrl/m": control})], 1.0, [])
    assert np.flatnonzero(np.isnan(slow["ctrl/m"])).tolist() == [2]


def test_what_is_thinned_keeps_the_whole_through_cuts_and_copies() -> None:
    whole = Recording(TIME, {"qpos/a": TIME, "ctrl/m": np.sin(TIME)}, source="a.npz")
    (slow,) = thinned([whole], 1.0, [])
    part = slow.rows(slice(10, 40)).replace(source="a.npz[10:40]")
    for one in (slow, part, copy.deepcopy(part), pickle.loads(pickle.dumps(part))):
        assert isinstance(one, Thinned)
        assert one.whole == whole
    assert pickle.loads(pickle.dumps(part)) == part
    assert pickle.loads(pickle.dumps(part)).source == part.source


def test_slow_recordings_stay_as_they_are() -> None:
    notes: list[str] = []
    one = Recording(TIME, {"qpos/a": TIME})
    assert thinned([one], MOST_SAMPLES * 1e-3, notes)[0] is one
    assert not notes


def test_windows_are_no_longer_than_most_recordings() -> None:
    """Tosses and flights: what is shorter than a window would not be looked at."""

    def flight(duration: float) -> Recording:
        time = np.arange(0.0, duration + 1e-9, 0.002)
        return Recording(time, {"qpos/ball": np.zeros((len(time), 1))})

    short = [flight(0.3) for _ in range(20)]
    assert usual_window([*short, flight(0.6)]) == pytest.approx(0.3)
    assert usual_window([flight(0.02) for _ in range(20)]) == pytest.approx(0.06)
    assert usual_window([flight(0.3), flight(4.0)]) == pytest.approx(0.5)
