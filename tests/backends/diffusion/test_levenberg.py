"""What is known beside an image."""

from __future__ import annotations

import numpy as np
import pytest
from orbisim_diffusion.levenberg import Prior


@pytest.mark.parametrize("tails", [np.inf, 4.0])
def test_a_priors_weight_is_the_slope_of_its_cost(tails: float) -> None:
    prior = Prior(np.array([0.1, -0.3]), np.array([0.02, 0.5]), tails)
    at, step = np.array([[0.3, 0.2], [0.11, -0.3]]), 1e-6
    slope = prior.weight(at) * (at - prior.centre)
    for axis in range(2):
        aside = np.zeros(2)
        aside[axis] = step
        found = (prior.cost(at + aside) - prior.cost(at - aside)) / (2.0 * step)
        np.testing.assert_allclose(found, slope[:, axis], rtol=1e-4, atol=1e-6)


def test_far_off_a_prior_with_tails_gives_in() -> None:
    centre, std = np.zeros(1), np.full(1, 0.02)
    near, far = np.array([[0.01]]), np.array([[0.4]])
    normal, tailed = Prior(centre, std), Prior(centre, std, 4.0)
    assert tailed.weight(near)[0, 0] == pytest.approx(normal.weight(near)[0, 0], rel=0.25)
    assert tailed.weight(far)[0, 0] < 0.02 * normal.weight(far)[0, 0]
