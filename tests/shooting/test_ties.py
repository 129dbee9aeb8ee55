"""Which numbers only a combination of is determined."""

import dataclasses

import numpy as np
import pytest

from orbisim.shooting.fits import Fit
from orbisim.shooting.ties import Tie, inverse_of, tied, ties


@pytest.mark.parametrize("seed", range(20))
def test_a_known_null_space_is_found(seed: int) -> None:
    """Columns that are sums of some others, whatever the sizes of the numbers: each combination is
    blind to every direction that changes nothing."""
    rng = np.random.default_rng(seed)
    own, more = int(rng.integers(1, 5)), int(rng.integers(1, 4))
    mix = rng.uniform(0.3, 1.0, (own, more)) * rng.choice([-1, 1], (own, more))
    mix *= rng.random((own, more)) < 0.7
    scale = 10 ** rng.uniform(-3, 3, own + more)
    columns = 100 * rng.standard_normal((400, own))
    every = np.column_stack([columns, columns @ mix]) / scale
    found = ties(every.T @ every, scale, own)
    assert {tie.first for tie in found} == set(np.flatnonzero(mix.any(axis=1)))
    null = np.vstack([-mix, np.eye(more)]) * scale[:, None]
    assert np.abs(every @ null).max() < 1e-8
    for tie in found:
        combination = np.zeros(own + more)
        combination[tie.first] = 1.0
        for k, coefficient in tie.others.items():
            combination[k] = coefficient
        assert np.abs(combination @ null).max() < 1e-3 * scale[tie.first]


def test_columns_of_their_own_are_tied_to_nothing() -> None:
    columns = 10 * np.random.default_rng(1).standard_normal((400, 4))
    assert ties(columns.T @ columns, np.ones(4), 2) == []


def test_two_fitted_numbers_of_which_the_sum_is_determined() -> None:
    shared = np.random.default_rng(2).standard_normal((200, 1))
    every = shared * [[5.0, 5.0]]
    (one,) = ties(every.T @ every, np.ones(2), 2)
    (other,) = one.others
    assert {one.first, other} == {0, 1}
    assert one.others[other] == pytest.approx(1.0)


def test_what_the_data_do_not_feel_is_tied_to_nothing() -> None:
    columns = np.random.default_rng(3).standard_normal((100, 1))
    every = np.column_stack([50 * columns, 0.05 * columns])  # of norms 500 and 0.5
    assert ties(every.T @ every, np.ones(2), 1) == []


def test_a_difference_that_the_data_are_sure_of_is_one() -> None:
    """Half of a column is another's: with few data that is not known, with many it is."""
    rng = np.random.default_rng(4)
    one, other = (c / np.linalg.norm(c) for c in rng.standard_normal((2, 300)))
    for size, expected in ((1.2, 1), (30.0, 0)):
        every = size * np.column_stack([one, 0.9 * one + 0.4 * other])
        assert len(ties(every.T @ every, np.ones(2), 1)) == expected


def test_an_exchange_that_cannot_be_is_none() -> None:
    column = 30 * np.random.default_rng(5).standard_normal((100, 1))
    every = np.column_stack([column, column])
    moves = []

    def never(moved: np.ndarray) -> bool:
        moves.append(moved)
        return False

    assert ties(every.T @ every, np.array([2.0, 2.0]), 1, possible=never) == []
    np.testing.assert_allclose(moves, [[-1.0]], rtol=1e-6)  # half of what there is


def test_numbers_that_say_where_are_fitted_beside_those_that_say_how_much() -> None:
    """What a place can make up for is no difference; a place is tied to nothing itself."""
    rng = np.random.default_rng(6)
    mass, place = 30 * rng.standard_normal((2, 300))
    every = np.column_stack([mass, place, mass - 2 * place])
    (one,) = ties(every.T @ every, np.array([1.0, 0.0, 1.0]), 2)
    assert one.first == 0 and one.others == {2: pytest.approx(1.0)}


def test_a_fit_in_terms_of_a_combination() -> None:
    """The sum is as sure as the data are of it, whatever they know of the parts."""
    rng = np.random.default_rng(7)
    count, windows = 3, 40
    jacobian = rng.standard_normal((windows, 6, count))
    jacobian[..., 1] = jacobian[..., 0] + 1e-6 * rng.standard_normal((windows, 6))
    information = np.einsum("wip,wiq->wpq", jacobian, jacobian)
    score = np.einsum("wip,wi->wp", jacobian, rng.standard_normal((windows, 6)))
    covariance = inverse_of(information.sum(axis=0))
    values = np.array([2.0, 3.0, 1.0])
    none = np.zeros(0)
    fit = Fit(values, none, 1.0, 1, covariance, np.zeros((windows, 6)), none, information, score)
    both = tied(fit, [Tie(0, {1: 1.0, 5: 0.7})], count)
    np.testing.assert_allclose(both.values, [5.0, 3.0, 1.0])
    spread = np.sqrt(np.diag(both.covariance))
    assert spread[0] < 0.2 < 1e3 < spread[1]
    back = tied(both, [Tie(0, {1: -1.0})], count)
    for name in ("values", "information", "score"):
        np.testing.assert_allclose(getattr(back, name), getattr(fit, name), atol=1e-9)
    assert dataclasses.replace(back, values=fit.values).count == fit.count
