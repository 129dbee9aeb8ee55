"""Controls that are held between samples: what a simulation with steps of its own sees of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbisim.recording.zero_order_hold import Held, led


@given(share=st.floats(-1.0, 1.0), parts=st.integers(1, 6), seed=st.integers(0, 99))
def test_a_signal_that_leads_has_the_means_of_one_that_changes_earlier_or_later(
    share: float, parts: int, seed: int
) -> None:
    values = np.random.default_rng(seed).normal(size=(7, 2))
    time = np.arange(7.0)
    changes = np.concatenate([[-2.0], time[1:] - share])
    moved = Held(changes, values).means(0.0, 1.0 / parts, 0, 6 * parts)
    found = led(values, share, parts)
    assert found.shape == (7, parts, 2)
    assert found[:-1].reshape(-1, 2) == pytest.approx(moved, abs=1e-5)
    if share >= 0:
        assert np.array_equal(found[-1], np.tile(values[-1], (parts, 1)))


def test_each_interval_may_have_a_share_of_its_own() -> None:
    values, shares = np.array([[0.0], [4.0], [8.0]]), np.array([0.25, 0.5])
    found = led(values, shares, 2)[..., 0]
    np.testing.assert_allclose(found, [[0.0, 2.0], [4.0, 8.0], [8.0, 8.0]])


def test_what_does_not_lead_stays_as_it_is() -> None:
    values = np.random.default_rng(0).normal(size=(5, 3))
    assert np.array_equal(led(values, 0.0)[:, 0], values)
    assert led(values, 1.0)[:-1, 0] == pytest.approx(values[1:])


def test_a_missing_sample_changes_none_beside_it() -> None:
    values = np.array([[1.0], [np.nan], [3.0], [5.0]])
    found = led(values, 0.5)[:, 0]
    np.testing.assert_array_equal(found, [[1.0], [np.nan], [4.0], [5.0]])


def test_means_between_borders_are_those_of_steps() -> None:
    rng = np.random.default_rng(3)
    held = Held(np.cumsum(rng.uniform(0.5, 1.5, 30)), rng.normal(size=(30, 2)))
    borders = held.time[0] + 0.37 * np.arange(91)
    found = held.within(np.stack([borders[:-1:3], borders[1::3], borders[2::3], borders[3::3]], 1))
    steps = held.means(held.time[0], 0.37, 0, 90)
    np.testing.assert_allclose(found, steps.reshape(30, 3, 2), atol=1e-12)
    assert borders[-1] > held.time[-1]  # the last value stays
    assert Held(held.time, np.zeros((30, 0))).within(borders[None]).shape == (1, 90, 0)


@given(st.floats(-1.0, 1.0), st.integers(1, 7), st.integers(0, 99))
def test_a_hold_that_is_moved_is_a_signal_that_leads(share: float, parts: int, seed: int) -> None:
    values = np.random.default_rng(seed).normal(size=(12, 2))
    time = 0.5 + 0.01 * np.arange(12)
    borders = time[:-1, None] + 0.01 * np.linspace(0.0, 1.0, parts + 1)
    found = Held(time, values).moved(np.full(11, share)).within(borders)
    np.testing.assert_allclose(found, led(values, share, parts)[:-1], atol=1e-9)
