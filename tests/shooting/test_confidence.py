"""Intervals of fitted parameters."""

import dataclasses

import numpy as np

from orbisim.shooting.confidence import confidence, told
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


def test_intervals_hold_where_windows_of_a_recording_share_an_error() -> None:
    """A mean, measured in windows whose errors are those of their recordings, nearly."""
    rng = np.random.default_rng(0)
    inside, blind = 0, 0
    for _ in range(300):
        of = np.repeat(np.arange(5), 20)
        seen = rng.normal(size=5)[of] + 0.1 * rng.normal(size=100)
        left = seen - seen.mean()
        fit = Fit(
            values=np.array([seen.mean()]), start=np.zeros((100, 0)), square=float(left @ left),
            count=99, covariance=np.array([[left @ left / 99 / 100]]), residual=left[:, None],
            per_window=left**2, information=np.ones((100, 1, 1)), score=left[:, None],
            recording=of,
        )  # fmt: skip
        low, high = confidence(fit, ["mean"])["mean"]
        inside += low <= 0.0 <= high
        low, high = confidence(dataclasses.replace(fit, recording=None), ["mean"])["mean"]
        blind += low <= 0.0 <= high
    assert 0.9 < inside / 300 < 0.99
    assert blind / 300 < 0.6


def test_numbers_count_as_told_by_their_intervals() -> None:
    fit = Fit(
        values=np.array([1.0, 3.0]), start=np.zeros((4, 0)), square=1.0, count=40,
        covariance=0.01 * np.eye(2), residual=np.zeros((4, 1)), per_window=np.ones(4),
        information=np.tile(100 * np.eye(2), (4, 1, 1)), score=np.zeros((4, 2)),
    )  # fmt: skip
    assert told(fit, [0], [0.0], [(0.8, 1.2)])
    assert not told(fit, [0], [0.0], [(-0.5, 2.5)])
    assert not told(fit, [1], [3.0], [(2.8, 3.2)])
    # an interval that reaches nothing on its longer side, whichever that is
    assert not told(fit, [0], [0.0], [(-0.1, 1.3)])
    assert not told(fit, [0], [2.0], [(0.7, 2.1)])
    assert told(fit, [0], [0.0], [(0.7, 2.5)])


def test_a_number_without_a_bound_is_not_told() -> None:
    fit = Fit(
        values=np.array([1.0, 3.0]), start=np.zeros((4, 0)), square=1.0, count=40,
        covariance=np.diag([1e200, 0.01]), residual=np.zeros((4, 1)), per_window=np.ones(4),
        information=np.tile(np.eye(2), (4, 1, 1)), score=np.zeros((4, 2)),
    )  # fmt: skip
    for wide in ((-np.inf, np.inf), (-1e300, 1e300), (np.nan, np.nan)):
        assert not told(fit, [0], [0.0], [wide])
        assert told(fit, [0, 1], [0.0, 0.0], [wide, (2.8, 3.2)])  # by the other


def test_priors_count_in_resamples_and_recordings() -> None:
    """An effect and a factor of which windows tell the sum only; a prior tells the factor."""
    rng = np.random.default_rng(0)
    slopes = np.ones((30, 1, 2)) + 1e-4 * rng.normal(size=(30, 1, 2))
    left = rng.normal(size=(30, 1))
    left -= left.mean()
    prior = np.diag([0.0, 1e4])
    information = np.einsum("wdp,wdq->wpq", slopes, slopes)
    fit = Fit(
        values=np.array([5.0, 1.0]), start=np.zeros((30, 0)), square=float((left**2).sum()),
        count=28, covariance=np.linalg.inv(information.sum(axis=0) + prior), residual=left,
        per_window=(left**2).ravel(), information=information,
        score=np.einsum("wdp,wd->wp", slopes, left), recording=np.repeat(np.arange(3), 10),
        prior=prior,
    )  # fmt: skip
    known = confidence(fit, ["effect", "factor"])
    assert 4.0 < known["effect"][0] < 4.8 and 5.2 < known["effect"][1] < 6.0
    assert known["factor"][1] - known["factor"][0] < 0.1
    blind = confidence(dataclasses.replace(fit, prior=None), ["effect", "factor"])
    assert blind["effect"][1] - blind["effect"][0] > 100.0


def test_few_independent_data_widen_an_interval() -> None:
    fit = Fit(
        values=np.array([1.0]), start=np.zeros((4, 0)), square=1.0, count=400,
        covariance=np.array([[0.01]]), residual=np.zeros((4, 1)), per_window=np.ones(4),
        information=np.full((4, 1, 1), 25.0), score=np.zeros((4, 1)),
    )  # fmt: skip
    low, high = confidence(fit, ["x"], independent=4.0)["x"]
    assert np.isclose(high - low, 2 * 1.96 * 0.1 * 10)
