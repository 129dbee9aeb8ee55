"""When commands change follows from a log, where they have a clock that is not the log's."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from orbisim.recording import Recording
from orbisim.recording.command_clock import (
    Lead,
    command_clock,
    command_periods,
    common_period,
)
from orbisim.recording.thinning import held_led
from orbisim.recording.zero_order_hold import led as led_by

RATE = 100.0
Floats = npt.NDArray[np.float64]


def _log(period: float, phase: float, count: int = 800, seed: int = 0) -> tuple[Floats, Floats]:
    """Stamps [T], s, and commands [T, 2] that change at phase + n * period."""
    time = np.arange(count) / RATE
    levels = np.random.default_rng(seed).permutation(2 * (count + 2)).reshape(-1, 2) + 0.0
    number = np.floor((time - phase) / period).astype(int) + 1
    return time, levels[np.maximum(number, 0)]


def _shares(time: Floats, period: float, phase: float) -> Floats:
    """[T - 1]: share of each interval that follows its tick."""
    ticks = phase + period * np.arange(int(time[-1] / period) + 1)
    shares = np.zeros(len(time) - 1)
    for tick in ticks[(ticks > 0) & (ticks < time[-1])]:
        row = int(np.searchsorted(time, tick)) - 1
        shares[row] = (time[row + 1] - tick) * RATE
    return shares


@settings(deadline=None, max_examples=100)  # each takes 40 ms
@given(st.floats(1.15, 8.0), st.floats(0.0, 1.0))
def test_a_share_is_what_is_left_of_an_interval_after_the_change(
    samples: float, place: float
) -> None:
    period = samples / RATE
    phase = place * period + 1e-7  # at a sample, rounding would decide
    time, values = _log(period, phase)
    found = command_clock(time, values)
    assume(found is not None)
    assert found is not None
    np.testing.assert_allclose(found, _shares(time, period, phase), atol=0.31)


@pytest.mark.parametrize("samples", [1.37, 2.718, 3.1416, 5.77])
def test_clocks_that_are_no_multiple_of_the_interval_are_found(samples: float) -> None:
    period, phase = samples / RATE, 0.4 * samples / RATE
    time, values = _log(period, phase)
    found = command_clock(time, values)
    assert found is not None
    np.testing.assert_allclose(found, _shares(time, period, phase), atol=0.1)


def test_stamps_may_jitter_and_commands_may_stay() -> None:
    rng, period, phase = np.random.default_rng(1), 2.718 / RATE, 0.011
    time, values = _log(period, phase)
    true = _shares(time, period, phase)
    stays = np.flatnonzero(true)[::7]
    for row in stays:  # the command of this tick is the one before
        values[row + 1 :] += values[row] - values[row + 1]
    found = command_clock(time + 1e-4 * rng.uniform(-1, 1, len(time)), values)
    assert found is not None
    true[stays] = 0.0
    np.testing.assert_allclose(found, true, atol=0.15)


@pytest.mark.parametrize("samples", [1.83, 2.718, 5.77])
def test_a_command_may_stay_for_many_ticks(samples: float) -> None:
    """How many ticks a long stay has, the gaps between changes are too coarse to say; the phases of
    all changes are not, nor is a period that is known."""
    rng, period, phase = np.random.default_rng(3), samples / RATE, 0.006
    time, values = _log(period, phase)
    true = _shares(time, period, phase)
    ticks = np.flatnonzero(true)
    for first in rng.choice(ticks[:-40], 5, replace=False):
        stays = ticks[ticks >= first][: rng.integers(10, 30)]
        for row in stays:
            values[row + 1 :] += values[row] - values[row + 1]
        true[stays] = 0.0
    shortest, longest = command_periods(time, values) or (0.0, 0.0)
    assert shortest <= period <= longest <= (1 + 2e-4) * shortest
    for known in (0.0, period):
        found = command_clock(time, values, known)
        assert found is not None
        np.testing.assert_allclose(found, true, atol=0.2)


@pytest.mark.parametrize("off", [-2e-4, 0.0])
def test_a_known_period_tells_a_clock_that_is_nearly_a_multiple(off: float) -> None:
    """In one log such a clock is at the same place of all intervals, wherever that is, but for the
    one or two times that it passes a sample."""
    period, phase = 2.9912 / RATE, 0.0085
    time, values = _log(period, phase, 598)
    assert command_clock(time, values) is None
    found = command_clock(time, values, (1 + off) * period)
    assert found is not None
    np.testing.assert_allclose(found, _shares(time, period, phase), atol=0.31)


def test_another_period_is_not_followed() -> None:
    time, values = _log(2.718 / RATE, 0.011)
    assert command_clock(time, values, 3.1416 / RATE) is None
    assert command_periods(time, np.zeros((len(time), 1))) is None


def test_what_one_log_leaves_open_another_rules_out() -> None:
    """Of a clock that passes three quarters of an interval in all of a log, each log leaves other
    periods open; all of them together hardly any but its own."""
    period = 3.2491 / RATE
    every = [command_periods(*_log(period, phase, 598)) for phase in (0.001, 0.0083, 0.0131, 0.02)]
    known = [one for one in every if one is not None]
    assert len(known) == 4 and all(low <= period <= high for low, high in known)
    widest = max(known, key=lambda one: one[1] - one[0])
    found = [common_period(one, known) for one in known]
    assert np.ptp(found) < 1e-12 and abs(found[0] / period - 1) < 1e-4
    assert common_period(widest, []) == pytest.approx(np.mean(widest))
    apart = (2 * widest[0], 2 * widest[1])
    assert common_period(widest, [apart]) == pytest.approx(np.mean(widest))  # an alias, say


def test_no_clock_where_the_log_leaves_it_open() -> None:
    rng = np.random.default_rng(0)
    time, values = _log(3.0 / RATE, 0.004)  # changes anywhere in every third interval
    assert command_clock(time, values) is None
    assert command_clock(time, rng.normal(size=(len(time), 1))) is None  # at every sample
    assert command_clock(time, np.repeat(rng.normal(size=8), 100)[:, None]) is None  # seldom
    rows = np.sort(rng.choice(len(time), 250, replace=False))  # at no regular time
    values = np.searchsorted(rows, np.arange(len(time)))[:, None].astype(float)
    assert command_clock(time, values) is None


def test_a_share_and_a_clock() -> None:
    time, values = np.arange(4.0), np.array([[0.0], [2.0], [2.0], [6.0]])
    np.testing.assert_array_equal(Lead(0.25).shares(time, values), [0.25, 0.25, 0.25])
    no_clock = Lead(0.25, clock=True).shares(time, values)
    np.testing.assert_array_equal(no_clock, [0.0, 0.0, 0.0])
    assert Lead(0.25) and Lead(clock=True) and not Lead()
    time, values = _log(2.718 / RATE, 0.011)
    shares = command_clock(time, values)
    assert shares is not None
    changes = np.flatnonzero(shares)
    for share in (0.0, -0.2):
        found = Lead(share, clock=True).shares(time, values)
        np.testing.assert_allclose(found[changes], np.clip(shares[changes] + share, 0, 1))


def test_recordings_have_a_clock_for_commands_and_one_for_torques() -> None:
    """Torques that change at every sample say nothing of the commands beside them."""
    time, values = _log(2.718 / RATE, 0.011)
    noisy = np.random.default_rng(0).normal(size=len(time))
    signals = {"ctrl/a": values[:, 0], "ctrl/b": values[:, 1], "torque/a": noisy}
    run = Recording(time, {"qpos/a": noisy, **signals})
    (led,) = held_led([run], Lead(clock=True))
    assert np.array_equal(led.signals["torque/a"], noisy)
    assert np.array_equal(led.signals["qpos/a"], noisy)
    means = led_by(values, Lead(clock=True).shares(time, values))[:, 0]
    assert np.array_equal(led.signals["ctrl/a"], means[:, 0])
    assert np.array_equal(led.signals["ctrl/b"], means[:, 1])
    assert not np.array_equal(means, values)
