"""The noise of signals whose noise is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orbisim.recording import Recording, bind, estimate_motion, noise_std
from orbisim.recording.noise import lattice_step
from orbisim.scene import load_scene


def swing(t):
    return np.sin(2 * np.pi * t + 0.3) + 0.3 * np.sin(2 * np.pi * 2.7 * t)


def chirp(t):
    return np.sin(2 * np.pi * (1 + 3 * t) * t)


def sampled(signal, count, interval, std, jitter, seed=0):
    rng = np.random.default_rng(seed)
    t = np.sort(interval * (np.arange(count) + jitter * rng.uniform(-1, 1, count)))
    return t, signal(t) + std * rng.standard_normal(count)


@pytest.mark.parametrize("jitter", [0.0, 0.3])
@pytest.mark.parametrize("std", [1e-6, 1e-4, 1e-2, 0.3])
@pytest.mark.parametrize("interval", [1e-3, 5e-3, 2e-2])
def test_white_noise_within_fifteen_percent(interval, std, jitter):
    t, y = sampled(swing, 1500, interval, std, jitter)
    assert noise_std(t, y) == pytest.approx(std, rel=0.15)


@pytest.mark.parametrize("std", [1e-4, 1e-2])
def test_chirp(std):
    t, y = sampled(chirp, 2000, 1e-3, std, 0.2)
    assert noise_std(t, y) == pytest.approx(std, rel=0.12)


def test_missing_samples_and_several_channels():
    t, a = sampled(swing, 2000, 2e-3, 1e-3, 0.1)
    b = sampled(chirp, 2000, 1e-3, 1e-2, 0.0, seed=1)[1]
    a[np.random.default_rng(2).random(2000) < 0.3] = np.nan
    np.testing.assert_allclose(noise_std(t, np.stack([a, b], 1)), [1e-3, 1e-2], rtol=0.15)


def test_impacts_are_not_noise():
    t = np.arange(600) / 200.0
    height = np.abs(np.sin(2.5 * t))  # rebounds at the zeros
    y = height + 1e-3 * np.random.default_rng(0).standard_normal(600)
    assert noise_std(t, y) == pytest.approx(1e-3, rel=0.2)


@given(step=st.floats(1e-5, 1e-1), dtype=st.sampled_from((np.float64, np.float32)))
@settings(deadline=None, max_examples=30)
def test_rounding_is_noise(step, dtype):
    t = np.arange(4000) * 1e-3
    y = (np.round(5 * swing(t) / step) * step).astype(dtype)
    assert noise_std(t, y) == pytest.approx(step / np.sqrt(12), rel=0.25)
    if step > 1e-3:  # below, neighbouring multiples are rarely both visited
        assert lattice_step(y) == pytest.approx(step, rel=0.05)


def test_at_rest_rounding_is_what_is_left():
    step = 2 * np.pi / 4096
    t = np.arange(1000) * 1e-3
    y = np.round(0.7 / step) * step + step * (t > 0.5)
    assert noise_std(t, y) == pytest.approx(step / np.sqrt(12), rel=1e-6)


def test_no_lattice_in_real_numbers():
    rng = np.random.default_rng(0)
    for values in (rng.standard_normal(300), swing(np.arange(500) * 1e-3), [1.0], [], [np.nan, 2]):
        assert lattice_step(np.asarray(values)) == 0
        assert lattice_step(np.asarray(values, np.float32)) == 0


def test_uniform_motion_is_no_lattice():
    """With and without noise, from rest, and with samples that are missing."""
    rng = np.random.default_rng(0)
    t = np.arange(110) * 8e-3
    rested, seen = np.maximum(t - 0.1013, 0.0), np.arange(110) % 25 > 0
    noisy = 3.5 * t + 5e-5 * rng.standard_normal(110)
    for y in (3.5 * t, 3.5 * t[seen], 3.5 * rested, noisy, noisy[seen]):
        assert lattice_step(y) == 0
    assert noise_std(t, noisy) == pytest.approx(5e-5, rel=0.2)


def test_a_lattice_of_which_no_value_is_read_again():
    """Motion so fast that steps are left out; with a thousandth of a step of noise it is none."""
    step = 1.5e-3
    counts = np.cumsum(np.random.default_rng(0).integers(1, 6, 300))
    assert lattice_step(step * counts) == pytest.approx(step)
    noisy = step * (counts + 1e-3 * np.random.default_rng(1).standard_normal(300))
    assert lattice_step(noisy) == 0


def test_no_noise_is_nearly_none():
    t = np.arange(1000) * 2e-3
    assert noise_std(t, swing(t)) < 1e-9
    assert noise_std(t, np.full(1000, 3.0)) == 0


def test_too_few_samples():
    assert np.isnan(noise_std(np.arange(4.0), np.arange(4.0)))
    assert noise_std(np.arange(9.0), np.full((9, 2), np.nan)).shape == (2,)


def test_long_signals_are_sampled():
    t = np.arange(3_000_000) * 1e-3
    y = swing(t) + 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    assert noise_std(t, y) == pytest.approx(1e-3, rel=0.05)


def test_noise_that_a_recording_states_is_a_floor() -> None:
    scene = load_scene(
        "<mujoco><worldbody><body name='cube'><freejoint name='cube'/>"
        "<geom type='box' size='.1 .1 .1'/></body></worldbody></mujoco>"
    )
    place, turn = np.tile([0.0, 0.0, 0.1], (20, 1)), np.tile([1.0, 0.0, 0.0, 0.0], (20, 1))
    still = Recording(np.arange(20) / 30, {"xpos/cube": place, "xquat/cube": turn})
    assert estimate_motion(bind(still, scene)).noise_std.max() < 1e-6
    said = still.replace(metadata={"noise": {"xpos/cube": 1e-3, "xquat/cube": 0.04}})
    found = estimate_motion(bind(said, scene)).noise_std
    np.testing.assert_allclose(found, [1e-3] * 3 + [0.04] * 3, rtol=1e-6)
    each = still.replace(metadata={"noise": {"xpos/cube": [1e-3, 2e-3, 3e-3], "xquat/cube": 0.04}})
    found = estimate_motion(bind(each, scene)).noise_std
    np.testing.assert_allclose(found, [1e-3, 2e-3, 3e-3, 0.04, 0.04, 0.04], rtol=1e-6)
    each = still.replace(metadata={"noise": {"xquat/cube": [0.01, 0.02, 0.03]}})
    found = estimate_motion(bind(each, scene)).noise_std
    np.testing.assert_allclose(found[3:], [0.01, 0.02, 0.03], rtol=1e-6)
    odd = still.replace(metadata={"noise": {"xpos/cube": "much", "xquat/cube": float("inf")}})
    assert estimate_motion(bind(odd, scene)).noise_std.max() < 1e-6
