"""Controls where samples are missing."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import orbisim
from orbisim.motion.samples import prepare_all
from orbisim.recording import Recording
from orbisim.recording.command_clock import Lead
from orbisim.recording.gaps import Bridged, bridged, interpolated
from orbisim.recording.thinning import MOST_SAMPLES, held_led, thinned
from orbisim.shooting.bench import make_bench

ARM = Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml"
TIME = np.arange(0, 4, 1e-3)


def test_missing_samples_have_rows_without_readings_and_with_controls_in_equal_steps() -> None:
    """Each is where it should have been, and what is there stays."""
    kept = np.delete(np.arange(20), [5, 10, 11, 12])
    control = np.stack([2.0 * kept, np.zeros(len(kept))], axis=1)
    signals = {"qpos": control, "ctrl": control, "torque/a": 3.0 * kept}
    one = Recording(0.01 * kept, signals, source="run", metadata={"robot": "a"})
    notes: list[str] = []
    (found,) = bridged([one], 0.5, notes)
    every = np.arange(20)
    np.testing.assert_allclose(found.time, 0.01 * every, rtol=1e-12)
    np.testing.assert_allclose(found["ctrl"][:, 0], 2.0 * every, rtol=1e-12)
    np.testing.assert_allclose(found["torque/a"], 3.0 * every, rtol=1e-12)
    assert np.array_equal(found["qpos"][kept], control)
    assert np.isnan(found["qpos"][[5, 10, 11, 12]]).all()
    assert (found.source, found.metadata) == ("run", {"robot": "a"})
    assert "missing at 2 places" in notes[0]
    assert "in no window" not in notes[0]  # straight lines miss nothing of these
    assert isinstance(found, Bridged)
    assert len(found.unknown) == 0
    assert isinstance(pickle.loads(pickle.dumps(found)), Bridged)


def test_controls_that_neighbours_do_not_tell_divide_windows() -> None:
    """A feedback of noisy readings: intervals driven by what nobody knows are in no window. A
    smooth course beside it is known all the same."""
    rng = np.random.default_rng(3)
    arm, time = orbisim.load_scene(ARM), 0.01 * np.arange(600)
    course, noisy = np.sin(3 * time), rng.normal(size=600)
    kept = np.delete(np.arange(600), [100, 101, 300])
    for second, unknown in (course, 0), (noisy, 3):
        both = np.stack([course, second], axis=1)
        run = Recording(time, {"qpos": 0.1 * np.stack([course, course], axis=1), "ctrl": both})
        notes: list[str] = []
        (found,) = bridged([run.rows(kept)], 0.5, notes)
        assert isinstance(found, Bridged)
        np.testing.assert_allclose(found.unknown, time[[100, 101, 300][:unknown]], rtol=1e-12)
        assert (f"{unknown} whose controls these do not tell" in notes[0]) == bool(unknown)
        (samples,) = prepare_all([found], arm)
        lost = [99, 100, 101, 102, 299, 300, 301] if unknown else []
        assert np.array_equal(np.flatnonzero(~samples.driven), lost)
        bench = make_bench(arm, [samples], 0.5)
        rows = bench.intervals.row[bench.windows.first, None] + np.arange(bench.windows.length)
        assert np.isin([100, 300], rows).all() == (unknown == 0)
        assert not np.isin(lost, rows).any()
        assert bench.looked_at == 1  # nothing is left out for want of time


def test_of_fast_samples_one_control_says_little() -> None:
    """At 1 kHz, what one sample may be off by does less than a thousandth of what 2 s do."""
    time = 1e-3 * np.arange(8000)
    run = Recording(time, {"qpos/a": time, "ctrl/m": np.random.default_rng(4).normal(size=8000)})
    part = run.rows(np.delete(np.arange(8000), [4000]))
    (slow,), (fast,) = bridged([part], 0.5, []), bridged([part], 2.0, [])
    assert isinstance(slow, Bridged)
    assert isinstance(fast, Bridged)
    assert (len(slow.unknown), len(fast.unknown)) == (1, 0)


def test_recordings_without_gaps_stay_as_they_are() -> None:
    notes: list[str] = []
    whole = Recording(TIME, {"qpos/a": TIME, "ctrl/m": np.sin(TIME)})
    assert bridged([whole], 0.5, notes)[0] is whole
    assert not notes


def test_a_value_that_is_not_known_stays_so() -> None:
    kept = np.delete(np.arange(400), [5, 200])
    lost = 1.0 * kept
    lost[kept == 6] = np.nan
    one = Recording(0.01 * kept, {"qpos/a": lost, "ctrl/lost": lost})
    (found,) = bridged([one], 0.5, [])
    assert found["ctrl/lost"][5] == pytest.approx(5.0)  # by 4 and 7
    assert np.isnan(found["ctrl/lost"][6])
    assert found["ctrl/lost"][200] == pytest.approx(200.0)


def test_where_a_clock_of_its_own_ticks_the_log_stays() -> None:
    """When a command changed, only the samples that there are say."""
    kept = np.delete(np.arange(400), [5, 200])
    ticks = np.floor((0.01 * kept - 0.004) / 0.0273)
    one = Recording(0.01 * kept, {"qpos/a": 1.0 * kept, "ctrl/clock": ticks})
    assert bridged([one], 0.5, [])[0] is one


@pytest.mark.parametrize("pause", [20.0, 1e9])
def test_nothing_is_made_up_in_a_pause(pause: float) -> None:
    time = np.append(0.01 * np.arange(300), pause + 0.01 * np.arange(300))
    one = Recording(time, {"qpos/a": time, "ctrl/m": np.sin(np.arange(600.0))})
    assert bridged([one], 0.5, [])[0] is one


@pytest.mark.parametrize(("lost", "crossed"), [(12, True), (13, False)])
def test_no_window_goes_through_a_long_gap(lost: int, crossed: bool) -> None:
    arm, time = orbisim.load_scene(ARM), 0.01 * np.arange(600)
    course = np.stack([np.sin(3 * time), np.cos(4 * time)], axis=1)
    run = Recording(time, {"qpos": 0.1 * course, "ctrl": course})
    (found,) = bridged([run.rows(np.delete(np.arange(600), range(300, 300 + lost)))], 0.5, [])
    (samples,) = prepare_all([found], arm)
    bench = make_bench(arm, [samples], 0.5)
    last = bench.intervals.row[bench.windows.first] + bench.windows.length
    across = (bench.intervals.row[bench.windows.first] < 300) & (last > 300)
    assert across.any() == crossed


def test_one_known_control_is_held() -> None:
    control = np.full(40, np.nan)
    control[0] = 2.0
    time = 0.01 * np.delete(np.arange(41), 1)
    (found,) = bridged([Recording(time, {"qpos/a": time, "ctrl/m": control})], 0.5, [])
    assert np.array_equal(found["ctrl/m"][:2], [2.0, 2.0])
    assert np.isnan(found["ctrl/m"][2:]).all()


def test_a_control_that_was_never_logged_is_not_unknown() -> None:
    time = 0.01 * np.delete(np.arange(400), 100)
    signals = {"qpos/a": time, "ctrl/m": time, "ctrl/n": np.full(399, np.nan)}
    (found,) = bridged([Recording(time, signals)], 0.5, [])
    assert isinstance(found, Bridged)
    assert len(found.unknown) == 0


def test_controls_that_lead_do_so_at_missing_samples_too() -> None:
    time = 0.01 * np.arange(400)
    run = Recording(time, {"qpos/a": time, "ctrl/m": np.sin(2 * time)})
    gone = np.delete(np.arange(400), [100, 101, 102])
    (part,) = bridged([run.rows(gone)], 0.5, [])
    (found,), (expected,) = held_led([part], Lead(0.5)), held_led([run], Lead(0.5))
    np.testing.assert_allclose(found["ctrl/m"], expected["ctrl/m"], atol=1e-3)


def test_smooth_controls_are_continued_smoothly() -> None:
    rng = np.random.default_rng(0)
    time = 0.01 * np.arange(800)
    waves = sum(
        np.sin(2 * np.pi * f * time + p)
        for f, p in zip((1.3, 4.1, 7.7), rng.uniform(0, 6, 3), strict=True)
    )
    there = rng.random(800) > 0.03
    there[[0, -1]] = True
    there[300:305] = False
    found, error = interpolated(np.where(there, waves, np.nan), there)
    straight = np.interp(time, time[there], waves[there])
    assert np.array_equal(found[there], waves[there])
    assert not error[there].any()
    inner = ~there & (np.arange(800) > 10) & (np.arange(800) < 790)
    assert np.abs(found - waves)[inner].std() < 0.25 * np.abs(straight - waves)[inner].std()
    assert np.sqrt(np.mean((found - waves)[inner] ** 2)) < 3 * error[inner].max()


def test_controls_at_random_are_their_mean() -> None:
    """No neighbour says anything: a straight line between two of them is further off."""
    rng = np.random.default_rng(1)
    values, there = 3.0 + rng.normal(size=4000), rng.random(4000) > 0.03
    there[[0, -1]] = True
    found, error = interpolated(np.where(there, values, np.nan), there)
    off, straight = found - values, np.interp(np.arange(4000), np.flatnonzero(there), values[there])
    assert off[~there].std() == pytest.approx(1.0, rel=0.25)
    assert error[~there] == pytest.approx(1.0, rel=0.3)
    assert off[~there].std() < 0.95 * (straight - values)[~there].std()


@given(st.integers(2, 400), st.floats(0.0, 0.9), st.integers(0, 99))
def test_what_is_there_stays_and_what_is_not_is_finite(count: int, lost: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values, there = rng.normal(size=count), rng.random(count) >= lost
    there[[0, -1]] = True
    unknown = there & (rng.random(count) < 0.1)
    unknown[[0, -1]] = False
    given_values = np.where(there & ~unknown, values, np.nan)
    found, error = interpolated(given_values, there)
    assert np.array_equal(found[there], given_values[there], equal_nan=True)
    assert np.isfinite(found[~there]).all()
    assert (error >= 0).all()
    assert not error[there].any()


def test_steps_see_each_control() -> None:
    """Also where the recording is then thinned, and where controls lead their samples."""
    arm = orbisim.load_scene(ARM)
    time = 0.005 * np.arange(1200)
    course = np.stack([np.sin(3 * time), np.cos(4 * time)], axis=1)
    whole = Recording(time, {"qpos": 0.1 * course, "ctrl": course})
    (found,) = bridged([whole.rows(np.delete(np.arange(1200), [401, 402, 801]))], 0.5, [])
    (samples,) = prepare_all([found], arm)
    np.testing.assert_allclose(samples.inputs(1)[0][400:403, 0], course[400:403], atol=1e-3)
    led = samples.led(Lead(0.5)).inputs(1)[0][400:403, 0]
    np.testing.assert_allclose(led, (course[400:403] + course[401:404]) / 2, atol=1e-3)
    assert np.isfinite(samples.qpos).all()  # the motion goes on where nothing was read
    assert np.isnan(samples.dq[401:403]).all()
    (few,) = prepare_all(thinned([found], 3 * MOST_SAMPLES * 0.005, []), arm)
    np.testing.assert_allclose(few.inputs(3)[0][100], course[300:303], atol=1e-9)


def test_a_thinned_recording_knows_which_controls_are_not_known() -> None:
    rng = np.random.default_rng(5)
    arm, time = orbisim.load_scene(ARM), 0.005 * np.arange(1200)
    whole = Recording(
        time, {"qpos": rng.normal(size=(1200, 2)), "ctrl": rng.normal(size=(1200, 2))}
    )
    (found,) = bridged([whole.rows(np.delete(np.arange(1200), [400, 800]))], 0.5, [])
    (few,) = prepare_all(thinned([found], 3 * MOST_SAMPLES * 0.005, []), arm)
    assert np.array_equal(np.flatnonzero(~few.driven), [132, 133, 134, 265, 266, 267])
