"""How recordings are cut into windows, and what their data say where impacts scatter them."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim.shooting.windows import (
    Bools,
    Floats,
    Whitening,
    Windows,
    cut_windows,
    start_size,
    whitening_of,
)


def cut(*lengths: int) -> list[tuple[int, int]]:
    """Recording and first interval of windows of ten intervals."""
    recording = np.repeat(np.arange(len(lengths)), lengths)
    row = np.concatenate([np.arange(n) for n in lengths])
    found = cut_windows(recording, row, 10)
    return [(int(recording[f]), int(row[f])) for f in found.first]


def test_windows_of_one_recording_each() -> None:
    assert cut(20, 10) == [(0, 0), (0, 10), (1, 0)]
    assert cut(17) == [(0, 0), (0, 7)]  # the last overlaps the one before
    assert cut(13) == [(0, 0)]  # hardly anything would be new


def test_a_recording_shorter_than_a_window_has_none() -> None:
    """Beside longer ones: no window reaches into the recording before."""
    assert cut(20, 7, 20) == [(0, 0), (0, 10), (2, 0), (2, 10)]
    assert cut(7) == []


SHAPE = 3, 6, 2
"""Windows, samples of each, signals."""


def _scattered(seed: int) -> tuple[Floats, Bools]:
    """Of some samples nothing, of some much; not all are seen."""
    rng = np.random.default_rng(seed)
    scatter = rng.exponential(3.0, SHAPE) * (rng.random(SHAPE) < 0.7)
    scatter[0, -2:, 0] = 1e3
    return scatter, rng.random(SHAPE) < 0.8


def _matrices(whitening: Whitening) -> Floats:
    """[W, ny, K + 1, K + 1]: by which the data of each window and signal are multiplied."""
    windows, samples, signals = SHAPE
    columns = np.zeros((*SHAPE, samples, signals))
    for sample in range(samples):
        for signal in range(signals):
            columns[:, sample, signal, sample, signal] = 1.0
    out = whitening(columns)
    for signal in range(signals):
        other = out[:, :, signal, :, 1 - signal]
        assert not other.any()  # no signal is mixed with another
    return np.array([[out[w, :, y, :, y] for y in range(signals)] for w in range(windows)])


@pytest.mark.parametrize("seed", range(4))
def test_whitened_data_are_independent(seed: int) -> None:
    scatter, seen = _scattered(seed)
    matrices = _matrices(Whitening(scatter, seen))
    for w, y in np.ndindex(SHAPE[0], SHAPE[2]):
        c = np.where(seen[w, :, y], scatter[w, :, y], 0.0)
        covariance = np.eye(len(c)) + np.diag(c**2) / 2 + np.outer(c, c) / 2
        matrix = matrices[w, y]
        np.testing.assert_allclose(matrix @ covariance @ matrix.T, np.eye(len(c)), atol=1e-8)


def test_columns_are_whitened_as_the_data_are() -> None:
    scatter, seen = _scattered(5)
    whitening, rng = Whitening(scatter, seen), np.random.default_rng(6)
    values = rng.normal(size=(*SHAPE, 4))
    every = whitening(values)
    for k in range(4):
        np.testing.assert_allclose(every[..., k], whitening(values[..., k]), atol=1e-14)


def test_data_that_nothing_scatters_stay_as_they_are() -> None:
    values = np.random.default_rng(0).normal(size=SHAPE)
    still = Whitening(np.zeros(SHAPE), np.ones(SHAPE, bool))
    np.testing.assert_array_equal(still(values), values)
    scatter = np.zeros(SHAPE)
    scatter[1, 2:, 1] = 5.0
    found = Whitening(scatter, np.ones(SHAPE, bool))(values)
    changed = found != values
    np.testing.assert_array_equal(changed, scatter > 0)


def test_what_is_not_seen_neither_counts_nor_is_changed() -> None:
    scatter, seen = _scattered(7)
    values = np.random.default_rng(8).normal(size=SHAPE)
    whitening = Whitening(scatter, seen)
    found = whitening(np.where(seen, values, 0.0))
    assert not found[~seen].any()
    other = Whitening(np.where(seen, scatter, np.inf), seen)  # whatever it scatters
    np.testing.assert_array_equal(other(values), whitening(values))
    np.testing.assert_array_equal(whitening(values)[~seen], values[~seen])


def test_what_may_be_anywhere_says_nothing() -> None:
    scatter = np.zeros(SHAPE)
    scatter[:, 3:] = 1e9  # of a run that has diverged
    values = np.random.default_rng(9).normal(size=SHAPE)
    found = Whitening(scatter, np.ones(SHAPE, bool))(values)
    np.testing.assert_array_equal(found[:, :3], values[:, :3])
    assert np.abs(found[:, 3:]).max() < 1e-5


def test_some_windows_are_whitened_as_all_are() -> None:
    scatter, seen = _scattered(10)
    values = np.random.default_rng(11).normal(size=SHAPE)
    whitening, which = Whitening(scatter, seen), np.array([2, 0, 2])
    before = whitening(values)
    np.testing.assert_array_equal(whitening.some(which)(values[which]), before[which])
    np.testing.assert_array_equal(whitening(values), before)  # and itself stays


def test_windows_are_whitened_by_what_is_measured_where_something_scatters() -> None:
    scatter, seen = _scattered(12)
    measured = np.array([3, 1])  # of four positions and velocities
    whole = np.full((3, 6, 4), 77.0)
    whole[:, :, measured] = scatter
    windows = Windows(np.arange(3), 5, np.zeros(3, int), scatter=whole)
    values = np.random.default_rng(13).normal(size=SHAPE)
    found = whitening_of(windows, measured, seen)
    assert found is not None
    np.testing.assert_array_equal(found(values), Whitening(scatter, seen)(values))
    for nothing in (None, np.zeros_like(whole)):
        plain = Windows(np.arange(3), 5, np.zeros(3, int), scatter=nothing)
        assert whitening_of(plain, measured, seen) is None
    some = windows.some(np.array([2])).scatter
    assert some is not None
    np.testing.assert_array_equal(some, whole[[2]])


def test_a_start_is_as_unknown_as_the_noise_is_large() -> None:
    q, v = np.array([1e-3, 2e-3, np.nan]), np.array([0.1, np.nan, np.nan])
    size = start_size((q, v), 0.01)
    np.testing.assert_allclose(size[:2], q[:2])
    assert size[3] == 0.1
    assert size[4] == pytest.approx(2e-3 / 0.04)  # by differences of positions
    assert size[2] == size[5] == 0.1  # of what is not measured at all, the most of any
