"""Value, rate and second derivative of signals for which they are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orbisim.errors import InputError
from orbisim.recording import smooth
from orbisim.recording.kalman import run_filter, run_smoother
from orbisim.recording.smoothing import smoothed
from tests.clock import Stopwatch


def swing(t, order=0):
    w, v = 2 * np.pi, 2 * np.pi * 2.7
    phase = order * np.pi / 2
    return w**order * np.sin(w * t + 0.3 + phase) + 0.3 * v**order * np.sin(v * t + phase)


def rms(x):
    return float(np.sqrt(np.nanmean(np.square(x))))


# -- the recursions against linear algebra ---------------------------------------------------------


def dense(step, measured, level, start, spread):
    """Mean and variance of the same posterior by solving for all states at once."""
    count = len(measured)
    precision, right = np.zeros((3 * count, 3 * count)), np.zeros(3 * count)
    precision[:3, :3] += np.linalg.inv(spread)
    right[:3] += np.linalg.inv(spread) @ start
    for i, h in enumerate(step):
        f = np.array([[1, h, h * h / 2], [0, 1, h], [0, 0, 1]])
        g = np.array(
            [
                [h**5 / 20, h**4 / 8, h**3 / 6],
                [h**4 / 8, h**3 / 3, h**2 / 2],
                [h**3 / 6, h**2 / 2, h],
            ]
        )
        q = np.linalg.inv(level[i] * g)
        block = np.block([[f.T @ q @ f, -f.T @ q], [-q @ f, q]])
        precision[3 * i : 3 * i + 6, 3 * i : 3 * i + 6] += block
    for i in np.flatnonzero(np.isfinite(measured)):
        precision[3 * i, 3 * i] += 1
        right[3 * i] += measured[i]
    mean = np.linalg.solve(precision, right).reshape(-1, 3)
    return mean, np.diag(np.linalg.inv(precision)).reshape(-1, 3)


@given(seed=st.integers(0, 2**32 - 1), level=st.floats(1e-4, 1e2))
@settings(deadline=None, max_examples=25)
def test_recursions_solve_the_normal_equations(seed, level):
    rng = np.random.default_rng(seed)
    count = 30
    step = rng.uniform(0.3, 2.0, (count - 1, 1))
    measured = 10 * rng.standard_normal() + np.cumsum(rng.standard_normal((count, 1)), axis=0)
    measured[rng.integers(3, count, 5)] = np.nan
    levels = np.where(rng.random((count - 1, 1)) < 0.1, 1e3 * level, level)
    filtered = run_filter(step, measured, levels)
    found = run_smoother(step, filtered)
    # the filter's start is not kept; after the first three samples it is the information so far
    c00, c01, c02, c11, c12, c22 = filtered.cov[2, :, 0]
    spread = np.array([[c00, c01, c02], [c01, c11, c12], [c02, c12, c22]])
    later = measured[2:, 0].copy()
    later[0] = np.nan
    mean, variance = dense(step[2:, 0], later, levels[2:, 0], filtered.mean[2, :, 0], spread)
    np.testing.assert_allclose(found.mean[2:, :, 0], mean, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found.variance[2:, :, 0], variance, rtol=1e-4, atol=1e-6)


def test_evidence_is_chi_square_without_events():
    """Standardised residuals of data drawn from the model itself."""
    rng = np.random.default_rng(0)
    series, count, level = 200, 120, 0.05
    h = 1.0
    g = np.array(
        [[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2], [h**3 / 6, h**2 / 2, h]]
    )
    root = np.linalg.cholesky(level * g)
    x = np.zeros((count, 3, series))
    f = np.array([[1, h, h * h / 2], [0, 1, h], [0, 0, 1]])
    for i in range(1, count):
        x[i] = f @ x[i - 1] + root @ rng.standard_normal((3, series))
    measured = x[:, 0] + rng.standard_normal((count, series))
    step = np.ones((count - 1, series))
    found = run_smoother(step, run_filter(step, measured, np.full((count - 1, series), level)))
    inside = slice(10, -10)
    assert found.outlier[inside].mean() == pytest.approx(1.0, abs=0.05)
    z = (found.mean - x)[inside] / np.sqrt(found.variance[inside])
    np.testing.assert_allclose((z**2).mean(axis=(0, 2)), 1.0, atol=0.06)


# -- estimates -------------------------------------------------------------------------------------


@pytest.mark.parametrize("std", [1e-5, 1e-3, 1e-2])
@pytest.mark.parametrize("interval", [1e-3, 5e-3])
def test_errors_are_what_the_estimate_says(interval, std):
    rng = np.random.default_rng(0)
    t = np.sort(interval * (np.arange(2000) + rng.uniform(-0.3, 0.3, 2000)))
    y = swing(t) + std * rng.standard_normal(2000)
    y[rng.random(2000) < 0.1] = np.nan
    found = smooth(t, y)
    for order, name in enumerate(("value", "rate", "second")):
        error = getattr(found, name) - swing(t, order)
        claimed = getattr(found, f"{name}_std")
        assert 0.2 < rms(error / claimed) < 1.3, name
    assert rms(found.value - swing(t)) < std
    assert found.noise_std == pytest.approx(std, rel=0.15)
    assert not found.jumps.any()
    assert not found.strays.any()


def test_better_than_finite_differences_and_savitzky_golay():
    from scipy.signal import savgol_filter

    rng = np.random.default_rng(1)
    t = np.arange(3000) * 1e-3
    y = swing(t) + 1e-3 * rng.standard_normal(3000)
    error = rms(smooth(t, y).rate - swing(t, 1))
    candidates = [
        rms(savgol_filter(y, width, 3, deriv=1, delta=1e-3) - swing(t, 1))
        for width in (5, 11, 21, 31, 51, 81, 121)
    ]
    assert error < 1.1 * min(candidates)  # the filter's width was chosen knowing the truth
    assert error < 0.05 * rms(np.gradient(y, t) - swing(t, 1))


def test_without_noise_it_differentiates_to_high_order():
    t = np.arange(1200) * 2e-3
    found = smooth(t, swing(t))
    inside = slice(20, -20)
    assert rms((found.rate - swing(t, 1))[inside]) < 1e-7
    assert rms((found.second - swing(t, 2))[inside]) < 1e-4


def test_polynomials_are_reproduced():
    t = np.linspace(0, 3, 40)
    y = np.stack([np.full(40, 2.0), 3 * t - 1, 0.5 * t**2], axis=1)
    found = smooth(t, y)
    np.testing.assert_allclose(found.value, y, atol=1e-6)
    np.testing.assert_allclose(found.rate, np.stack([0 * t, 3 + 0 * t, t], axis=1), atol=1e-5)
    np.testing.assert_allclose(found.second[:, 2], 1.0, atol=1e-4)


def test_gaps_widen_the_error():
    rng = np.random.default_rng(0)
    t = np.arange(1000) * 2e-3
    y = swing(t) + 1e-3 * rng.standard_normal(1000)
    y[500:520] = np.nan
    found = smooth(t, y)
    assert np.isfinite(found.value).all()
    assert found.value_std[510] > 2 * found.value_std[400]
    assert abs(found.value[510] - swing(t[510])) < 4 * found.value_std[510]


def test_long_gaps_and_ends_are_not_filled():
    t = np.arange(2000) * 1e-3
    y = swing(t)
    y[:10], y[-10:], y[600:1200] = np.nan, np.nan, np.nan
    found = smooth(t, y)
    filled = np.isfinite(found.rate)
    assert not filled[:10].any()
    assert not filled[-10:].any()
    assert not filled[600:1200].any()
    assert filled[10:600].all()
    assert filled[1200:-10].all()
    assert rms((found.rate - swing(t, 1))[[595, 599, 1200, 1205]]) < 1e-2


def test_a_slow_sensor_in_a_fast_table():
    rng = np.random.default_rng(0)
    t = np.arange(3000) * 1e-3
    y = np.full((3000, 2), np.nan)
    y[:, 0] = swing(t) + 1e-3 * rng.standard_normal(3000)
    y[::20, 1] = swing(t[::20]) + 1e-3 * rng.standard_normal(150)
    found = smooth(t, y)
    np.testing.assert_allclose(found.noise_std, 1e-3, rtol=0.5)
    assert rms((found.rate[:, 1] - swing(t, 1))[60:-60]) < 0.15


def bounces(t, speed=3.0, restitution=0.8, g=9.81):
    """Height and velocity of a ball that is thrown up from the table."""
    z, v, start = np.empty_like(t), np.empty_like(t), 0.0
    for i, now in enumerate(t):
        while now - start > 2 * speed / g:
            start, speed = start + 2 * speed / g, restitution * speed
        z[i] = speed * (now - start) - g / 2 * (now - start) ** 2
        v[i] = speed - g * (now - start)
    return z, v


def test_impacts_do_not_spoil_the_flight():
    t = np.arange(280) / 140.0
    z, v = bounces(t)
    y = z + 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    found, plain = smooth(t, y), smooth(t, y, events=False)
    struck = np.flatnonzero(np.diff(v) > 1.0)
    assert all(found.jumps[max(i - 1, 0) : i + 2].any() for i in struck)
    assert found.jumps.sum() <= 2 * len(struck)
    away = np.ones(len(t), bool)
    for i in struck:
        away[i - 1 : i + 3] = False
    assert rms((found.rate - v)[away]) < 0.02
    assert rms((found.rate - v)[away]) < 0.3 * rms((plain.rate - v)[away])
    assert abs(found.rate[0] - v[0]) < 4 * found.rate_std[0] < 0.1


def test_stray_samples_are_left_out():
    rng = np.random.default_rng(0)
    t = np.arange(1500) * 2e-3
    y = swing(t) + 1e-3 * rng.standard_normal(1500)
    hit = np.array([0, 300, 301, 777, 1499])
    y[hit] += [0.1, -0.2, -0.2, 0.05, 0.3]
    found = smooth(t, y)
    assert found.strays[[300, 777]].all()
    assert set(np.flatnonzero(found.strays)) <= set(hit)
    assert rms((found.rate - swing(t, 1))[5:-5]) < 0.06


@pytest.mark.parametrize("count", [2, 3, 4, 7])
def test_few_samples(count):
    t = np.array([0.0, 0.1, 0.25, 0.3, 0.5, 0.55, 0.8])[:count]
    found = smooth(t, 2 * t + 1)
    np.testing.assert_allclose(found.rate, 2.0, atol=1e-3)
    assert smooth(t, np.full(count, np.nan)).rate.shape == (count,)


def test_one_sample_in_a_channel_gives_nothing():
    found = smooth(np.arange(5.0), [[1.0, 0], [np.nan, 1], [np.nan, 2], [np.nan, 3], [np.nan, 4]])
    assert np.isnan(found.rate[:, 0]).all()
    np.testing.assert_allclose(found.rate[:, 1], 1.0, atol=1e-3)


@given(scale=st.floats(1e-6, 1e6), shift=st.floats(-1e3, 1e3), slow=st.floats(1e-3, 1e3))
@settings(deadline=None, max_examples=8)
def test_units_do_not_matter(scale, shift, slow):
    rng = np.random.default_rng(0)
    t = np.arange(200) * 1e-2
    y = swing(t) + 1e-2 * rng.standard_normal(200)
    a, b = smooth(t, y), smooth(slow * t, scale * y + shift * scale)
    np.testing.assert_allclose(b.rate * slow / scale, a.rate, rtol=1e-3, atol=2e-3)
    np.testing.assert_allclose(b.rate_std * slow / scale, a.rate_std, rtol=1e-3)


def test_blocks_agree_with_one_piece():
    rng = np.random.default_rng(3)
    t = np.arange(1500) * 1e-3
    y = swing(t) + 1e-3 * rng.standard_normal(1500)
    whole = smooth(t, y, noise_std=1e-3)
    part = smooth(t[700:1100], y[700:1100], noise_std=1e-3)
    assert rms((whole.rate[700:1100] - part.rate)[60:-60]) < 0.2 * rms(part.rate_std)


def test_wrong_input():
    with pytest.raises(InputError, match="strictly increase"):
        smooth([0.0, 0.0], [1.0, 2.0])
    with pytest.raises(InputError, match="strictly increase"):
        smooth([0.0], [1.0])
    with pytest.raises(InputError, match="need a row for each time"):
        smooth([0.0, 1.0], [1.0, 2.0, 3.0])


def test_ten_thousand_samples_of_six_channels_take_seconds():
    rng = np.random.default_rng(0)
    t = np.arange(10_000) * 1e-3
    y = np.stack([swing(t + 0.1 * k) for k in range(6)], axis=1)
    watch = Stopwatch()
    found = smooth(t, y + 1e-3 * rng.standard_normal(y.shape))
    assert watch.seconds < 15  # about half a second on an idle machine
    assert rms(found.rate - np.stack([swing(t + 0.1 * k, 1) for k in range(6)], axis=1)) < 0.05


def test_the_same_samples_are_smoothed_once() -> None:
    time, noise = np.arange(200) / 100.0, np.full(2, 1e-3)
    values = np.sin(3 * time)[:, None] + 1e-3 * np.random.default_rng(0).standard_normal((200, 2))
    first = smoothed(time, values, noise)
    assert smoothed(time.copy(), values.copy(), noise.copy()) is first
    assert (first.value == smooth(time, values, noise_std=noise).value).all()
    with pytest.raises(ValueError, match="read-only"):
        first.value[0] = 1.0
    kept = first.value.copy()
    time[150:] += 0.5
    values[50] += 0.5
    again = smoothed(time, values, noise)
    assert again is not first and not (again.value == first.value).all()
    assert (first.value == kept).all() and first.time[-1] < 2.0
