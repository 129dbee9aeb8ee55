"""Controls where samples are missing."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import orbisim
from orbisim.motion.samples import prepare_all
from orbisim.recording import Recording
from orbisim.recording.command_clock import Lead
from orbisim.recording.gaps import bridged, interpolated
from orbisim.recording.thinning import MOST_SAMPLES, Thinned, held_led, thinned

ARM = Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml"
TIME = np.arange(0, 4, 1e-3)


def test_controls_where_samples_are_missing_are_means() -> None:
    """One lost sample: a half of the interval as it was, the other half way to the next. Three: in
    equal steps. What is not held stays."""
    kept = np.delete(np.arange(20), [5, 10, 11, 12])
    control = np.stack([2.0 * kept, np.zeros(len(kept))], axis=1)
    one = Recording(0.01 * kept, {"qpos": control, "ctrl": control, "torque/a": 3.0 * kept})
    notes: list[str] = []
    (found,) = bridged([one], notes)
    expected = control.copy()
    expected[kept == 4, 0] += 0.5 * 2.0
    expected[kept == 9, 0] += 1.5 * 2.0
    np.testing.assert_allclose(found["ctrl"], expected, rtol=1e-12)
    assert found["torque/a"][kept == 9] == pytest.approx(3.0 * 9 + 1.5 * 3.0)
    assert np.array_equal(found["qpos"], control)
    assert "missing at 2 places" in notes[0]
    assert isinstance(found, Thinned)
    np.testing.assert_allclose(found.whole["ctrl"][:, 0], 2.0 * np.arange(20), rtol=1e-12)


def test_recordings_without_gaps_or_with_steady_controls_stay_as_they_are() -> None:
    notes: list[str] = []
    whole = Recording(TIME, {"qpos/a": TIME, "ctrl/m": np.sin(TIME)})
    steady = Recording(np.delete(TIME, 7), {"qpos/a": TIME[1:], "ctrl/m": np.ones(len(TIME) - 1)})
    assert all(
        a is b for a, b in zip(bridged([whole, steady], notes), [whole, steady], strict=True)
    )
    assert not notes


def test_a_value_that_is_not_known_stays_so_and_a_clock_of_its_own_ticks_on() -> None:
    kept = np.delete(np.arange(400), [5, 200])
    lost = 1.0 * kept
    lost[kept == 6] = np.nan
    ticks = np.floor((0.01 * kept - 0.004) / 0.0273)  # a clock of its own
    one = Recording(0.01 * kept, {"qpos/a": lost, "ctrl/lost": lost, "ctrl/clock": ticks})
    (found,) = bridged([one], [])
    assert found["ctrl/lost"][kept == 4] == pytest.approx(4.5)  # by 4 and 7
    assert np.isnan(found["ctrl/lost"][kept == 6]).all()
    assert found["ctrl/lost"][kept == 199] == pytest.approx(199.5)
    assert np.array_equal(found["ctrl/clock"], ticks)


@pytest.mark.parametrize("pause", [20.0, 1e9])
def test_nothing_is_made_up_in_a_pause(pause: float) -> None:
    time = np.append(0.01 * np.arange(300), pause + 0.01 * np.arange(300))
    one = Recording(time, {"qpos/a": time, "ctrl/m": np.sin(np.arange(600.0))})
    assert bridged([one], [])[0] is one


def test_one_known_control_is_held() -> None:
    control = np.full(40, np.nan)
    control[0] = 2.0
    time = 0.01 * np.delete(np.arange(41), 1)
    (found,) = bridged([Recording(time, {"qpos/a": time, "ctrl/m": control})], [])
    assert found["ctrl/m"][0] == 2.0
    assert np.isnan(found["ctrl/m"][1:]).all()


def test_controls_that_lead_do_so_in_between_too() -> None:
    time = 0.01 * np.arange(400)
    run = Recording(time, {"qpos/a": time, "ctrl/m": np.sin(2 * time)})
    gone = np.delete(np.arange(400), [100, 101, 102])
    (part,) = bridged([run.rows(gone)], [])
    (found,), (expected,) = held_led([part], Lead(0.5)), held_led([run], Lead(0.5))
    assert isinstance(found, Thinned)
    np.testing.assert_allclose(found.whole["ctrl/m"], expected["ctrl/m"], atol=1e-3)
    row = int(np.flatnonzero(gone == 99)[0])
    assert found["ctrl/m"][row] == pytest.approx(expected["ctrl/m"][99:103].mean(), abs=1e-3)
    np.testing.assert_allclose(found["ctrl/m"][:90], expected["ctrl/m"][:90], rtol=1e-12)


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
    found = interpolated(np.where(there, waves, np.nan), there)
    straight = np.interp(time, time[there], waves[there])
    assert np.array_equal(found[there], waves[there])
    inner = ~there & (np.arange(800) > 10) & (np.arange(800) < 790)
    assert np.abs(found - waves)[inner].std() < 0.25 * np.abs(straight - waves)[inner].std()


def test_controls_at_random_are_their_mean() -> None:
    """No neighbour says anything: a straight line between two of them is further off."""
    rng = np.random.default_rng(1)
    values, there = 3.0 + rng.normal(size=4000), rng.random(4000) > 0.03
    there[[0, -1]] = True
    found = interpolated(np.where(there, values, np.nan), there)
    off, straight = found - values, np.interp(np.arange(4000), np.flatnonzero(there), values[there])
    assert off[~there].std() == pytest.approx(1.0, rel=0.25)
    assert off[~there].std() < 0.95 * (straight - values)[~there].std()


@given(st.integers(2, 400), st.floats(0.0, 0.9), st.integers(0, 99))
def test_what_is_there_stays_and_what_is_not_is_finite(count: int, lost: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values, there = rng.normal(size=count), rng.random(count) >= lost
    there[[0, -1]] = True
    unknown = there & (rng.random(count) < 0.1)
    unknown[[0, -1]] = False
    given_values = np.where(there & ~unknown, values, np.nan)
    found = interpolated(given_values, there)
    assert np.array_equal(found[there], given_values[there], equal_nan=True)
    assert np.isfinite(found[~there]).all()


def test_steps_between_samples_see_each_control() -> None:
    """Also where the recording is then thinned, and where controls lead their samples."""
    arm = orbisim.load_scene(ARM)
    time = 0.005 * np.arange(1200)
    course = np.stack([np.sin(3 * time), np.cos(4 * time)], axis=1)
    whole = Recording(time, {"qpos": 0.1 * course, "ctrl": course})
    kept = np.delete(np.arange(1200), [401, 402, 801])
    (found,) = bridged([whole.rows(kept)], [])
    (samples,) = prepare_all([found], arm)
    row = int(np.flatnonzero(kept == 400)[0])
    ctrl = samples.inputs(3)[0]
    np.testing.assert_allclose(ctrl[row], course[400:403], atol=1e-3)
    led = samples.led(Lead(0.5)).inputs(3)[0]
    np.testing.assert_allclose(led[row], (course[400:403] + course[401:404]) / 2, atol=1e-3)
    (few,) = prepare_all(thinned([found], 3 * MOST_SAMPLES * 0.005, []), arm)
    np.testing.assert_allclose(few.inputs(3)[0][100], course[300:303], atol=1e-9)
