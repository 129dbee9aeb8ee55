"""To unit scale and back."""

from __future__ import annotations

import math

import pytest
import torch
from orbisim_world_model.normalization import Normalizer, fine

VALUES = torch.tensor([[1.0, 5.0, -2.0], [3.0, 5.0, 2.0], [5.0, 5.0, 6.0]])


def test_unit_scale_and_back() -> None:
    normalizer = Normalizer(3)
    normalizer.fit(VALUES)
    scaled = normalizer(VALUES)
    torch.testing.assert_close(scaled.mean(0), torch.zeros(3))
    torch.testing.assert_close(scaled[:, [0, 2]].std(0, correction=0), torch.ones(2))
    assert (scaled[:, 1] == 0).all()  # what does not vary
    torch.testing.assert_close(normalizer.undo(scaled), VALUES)


def test_what_did_not_vary_is_never_predicted_to() -> None:
    normalizer = Normalizer(3, output=True)
    normalizer.fit(VALUES)
    assert (normalizer.undo(torch.randn(7, 3))[:, 1] == 5.0).all()


def test_about_zero() -> None:
    normalizer = Normalizer(3, centered=False)
    normalizer.fit(VALUES)
    assert (normalizer.mean == 0).all()
    torch.testing.assert_close(normalizer.std, VALUES.square().mean(0).sqrt())


def test_rows_that_do_not_count() -> None:
    some, all_ = Normalizer(3), Normalizer(3)
    junk = torch.cat([VALUES, torch.full((2, 3), 1e6)])
    some.fit(junk, torch.tensor([1.0, 1, 1, 0, 0]))
    all_.fit(VALUES)
    torch.testing.assert_close(some.mean, all_.mean)
    torch.testing.assert_close(some.std, all_.std)


def test_nothing_to_fit_changes_nothing() -> None:
    normalizer = Normalizer(3)
    normalizer.fit(torch.zeros(0, 3))
    normalizer.fit(VALUES, torch.zeros(3))
    assert (normalizer.std == 1).all()


@pytest.mark.parametrize("sign", [-1, 1])
def test_fine_is_linear_below_and_logarithmic_above(sign: int) -> None:
    small, large = torch.tensor([1e-4, 100.0]) * sign
    expected = float(small) / 0.02, sign * math.log(2 * 100.0 / 0.02)
    assert float(fine(small, 0.02)) == pytest.approx(expected[0], rel=1e-4)
    assert float(fine(large, 0.02)) == pytest.approx(expected[1], rel=1e-4)
