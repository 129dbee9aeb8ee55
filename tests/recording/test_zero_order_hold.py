"""Controls that are held between samples: what a simulation with steps of its own sees of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbisim.recording.zero_order_hold import Held, led


@given(share=st.floats(0.0, 1.0), seed=st.integers(0, 99))
def test_a_signal_that_leads_has_the_means_of_one_that_changes_earlier(
    share: float, seed: int
) -> None:
    values = np.random.default_rng(seed).normal(size=(7, 2))
    time = np.arange(7.0)
    changes = np.concatenate([[0.0], time[1:] - share])
    earlier = Held(changes, values).means(0.0, 1.0, 0, 6)
    assert led(values, share)[:-1] == pytest.approx(earlier, abs=1e-5)
    assert np.array_equal(led(values, share)[-1], values[-1])


def test_what_does_not_lead_stays_as_it_is() -> None:
    values = np.random.default_rng(0).normal(size=(5, 3))
    assert np.array_equal(led(values, 0.0), values)
    assert led(values, 1.0)[:-1] == pytest.approx(values[1:])


def test_a_missing_sample_changes_none_beside_it() -> None:
    values = np.array([[1.0], [np.nan], [3.0], [5.0]])
    np.testing.assert_array_equal(led(values, 0.5), [[1.0], [np.nan], [4.0], [5.0]])
