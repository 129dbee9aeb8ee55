"""Normal equations, against least squares of all columns at once."""

import dataclasses

import numpy as np
import pytest

from orbisim.shooting.regress import (
    Normal,
    fit,
    left_by_each,
    levelled,
    normal_of,
    profiled,
    scaled_gram,
    total,
    without_start,
)

RNG = np.random.default_rng(2)
DESIGN, TARGET = RNG.standard_normal((30, 5)), RNG.standard_normal(30)


def test_a_start_is_projected_out() -> None:
    both = np.linalg.lstsq(DESIGN, TARGET, rcond=None)[0]
    kept = without_start(DESIGN, TARGET, 2, 30)
    assert kept.rows == 28
    x, left = fit(normal_of(*kept), [0, 1, 2])
    np.testing.assert_allclose(x, both[2:], rtol=1e-8)
    assert left == pytest.approx(((TARGET - DESIGN @ both) ** 2).sum())


def test_a_start_that_changes_nothing_takes_no_datum() -> None:
    blank = DESIGN.copy()
    blank[:, 0] = 0.0
    assert without_start(blank, TARGET, 2, 30).rows == 29


def test_rows_beyond_what_numbers_hold_say_nothing() -> None:
    design, target = DESIGN.copy(), TARGET.copy()
    design[3, 1], design[5, 0], target[7] = 1e200, np.nan, np.inf
    kept = without_start(design, target, 2, 30)
    rest = np.delete(np.arange(30), (3, 5, 7))
    there = without_start(DESIGN[rest], TARGET[rest], 2, 27)
    assert kept.rows == there.rows == 25
    assert np.linalg.norm(kept.target) == pytest.approx(np.linalg.norm(there.target))


def test_nuisance_columns_with_a_prior_are_fitted_away() -> None:
    ridge = np.array([3.0, 0.5])
    padded = np.vstack([DESIGN, np.diag([0, 0, 0, *np.sqrt(ridge)])])
    both = np.linalg.lstsq(padded, np.append(TARGET, np.zeros(5)), rcond=None)[0]
    x, left = fit(profiled(normal_of(DESIGN, TARGET, 30), [3, 4], ridge), [0, 1, 2])
    np.testing.assert_allclose(x, both[:3], rtol=1e-8)
    assert left == pytest.approx(((np.append(TARGET, np.zeros(5)) - padded @ both) ** 2).sum())


def test_windows_add_up() -> None:
    parts = [normal_of(DESIGN[i::3], TARGET[i::3], 10) for i in range(3)]
    whole, added = normal_of(DESIGN, TARGET, 30), total(parts)
    np.testing.assert_allclose(added.gram, whole.gram)
    assert (added.count, added.square) == (30, pytest.approx(whole.square))


def test_a_column_of_which_nothing_is_left_has_no_coefficient() -> None:
    """Of strong columns rounding leaves a little, on either side of nothing."""
    huge = np.column_stack([DESIGN, DESIGN[:, 0]]) * np.array([1e18, 1, 1, 1, 1, 1e18])
    rest = profiled(normal_of(huge, TARGET, 30), [0], np.zeros(1))
    below = rest.gram.copy()
    below[5, 5] = -abs(below[5, 5]) - 1.0
    x, left = fit(dataclasses.replace(rest, gram=below), [1, 5])
    assert x[1] == 0.0
    assert left == pytest.approx(fit(rest, [1])[1], rel=1e-6)


@pytest.mark.parametrize("strength", [np.inf, np.nan, 1e-310, -1e-12])
def test_a_column_that_overflows_or_is_none_has_no_coefficient(strength: float) -> None:
    """The others have what they have without it."""
    gram = np.array([[4.0, 1.0, 1e40], [1.0, 2.0, -1e40], [1e40, -1e40, strength]])
    normal = Normal(gram, np.array([2.0, 3.0, 1e30]), 10.0, 50)
    x, left = fit(normal, [0, 1, 2])
    without, square = fit(normal, [0, 1])
    np.testing.assert_allclose(x, [*without, 0.0], rtol=1e-9)
    assert left == pytest.approx(square)
    gone = profiled(normal, [1, 2], np.zeros(2))
    assert np.isfinite(gone.gram[:2, :2]).all()
    scaled, scale = scaled_gram(np.stack([gram, np.eye(3)]))
    assert np.isfinite(scaled).all() and np.isinf(scale[0, 2])
    np.testing.assert_array_equal(scaled[1], np.eye(3))


def test_windows_that_leave_much_more_than_most_weigh_less() -> None:
    one = Normal(np.eye(2), np.ones(2), 10.0, 10)
    many = [one, one, one, Normal(np.eye(2), np.ones(2), 4000.0, 10)]
    weights = [float(n.gram[0, 0]) for n in levelled(many)]
    assert weights == pytest.approx([1, 1, 1, 0.05])
    clean = Normal(np.eye(2), np.ones(2), 0.0, 10)
    assert all(n.gram[0, 0] == 1 for n in levelled([clean, clean, one]))


def test_what_each_column_alone_leaves_is_what_its_fit_does() -> None:
    """Also of a column that is none, or that overflows."""
    design = np.column_stack([DESIGN, np.zeros(30)])
    normal = normal_of(design, TARGET, 30)
    gram, moment = normal.gram.copy(), normal.moment.copy()
    gram[0, 0] = moment[0] = np.inf
    for one in (normal, Normal(gram, moment, normal.square, normal.count)):
        left = left_by_each(one)
        assert left == pytest.approx([fit(one, [column])[1] for column in range(6)])
        assert left[5] == one.square and (left[1:5] < one.square).all()
