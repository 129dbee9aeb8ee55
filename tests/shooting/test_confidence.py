"""Intervals of fitted parameters."""

import numpy as np

from orbisim.shooting.confidence import confidence
from orbisim.shooting.fits import Fit


def test_a_resample_without_what_feels_a_parameter_says_nothing() -> None:
    """One window of many feels it: a third of all resamples are without."""
    windows = 12
    information = np.full((windows, 1, 1), 1e-12)
    information[3] = 100.0
    fit = Fit(
        values=np.array([2.0]), start=np.zeros((windows, 2)), square=1.0, count=100,
        covariance=np.array([[0.01]]), residual=np.zeros((windows, 4)),
        per_window=np.ones(windows), information=information,
        score=np.where(np.arange(windows)[:, None] == 3, 0.5, 1e-3),
    )  # fmt: skip
    low, high = confidence(fit, ["force"])["force"]
    assert 1.7 < low < 1.81 and 2.19 < high < 2.3
