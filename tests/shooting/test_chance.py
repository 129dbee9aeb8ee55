"""How many data count as independent, by what effects explain by chance."""

import numpy as np

from orbisim.evidence import independent_by_chance


def _random(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def test_of_independent_data_all_count() -> None:
    columns, left = _random(40, 100, 60), _random(40, 100, seed=1)
    found = independent_by_chance(columns, left, np.ones(40))
    assert 1500 < found < 12000  # of 4000; the median of 60 shares is known to a factor


def test_structure_that_returns_in_every_window_counts_once() -> None:
    shape = np.sin(np.arange(100) / 15)
    left = np.repeat(shape[None], 40, axis=0)
    columns = np.repeat(np.cumsum(_random(1, 100, 60), axis=1), 40, axis=0)
    assert independent_by_chance(columns, left, np.ones(40)) < 40


def test_what_was_fitted_is_no_chance() -> None:
    own, other = _random(40, 100, 12), _random(40, 100, 12, seed=1)
    left = _random(40, 100, seed=2)
    columns = own + 1e-3 * other
    beside = independent_by_chance(columns, left, np.ones(40), own)
    assert np.isclose(beside, independent_by_chance(other, left, np.ones(40), own), rtol=1e-3)


def test_few_columns_say_nothing() -> None:
    assert independent_by_chance(_random(4, 10, 3), _random(4, 10), np.ones(4)) == np.inf
