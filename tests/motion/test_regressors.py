"""Frequencies at which a missing force is looked for."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim.motion.regressors import _frequency_grid


@pytest.mark.parametrize("travel", [1e-13, 1e-3, 0.1, 2.0, 40.0])
def test_they_are_few_however_little_a_joint_moves(travel: float) -> None:
    grid = _frequency_grid(np.linspace(0.3, 0.3 + travel, 50), "position")
    assert 0 < len(grid) < 4000
    assert grid[0] * travel >= 0.99 * np.pi / 2  # a quarter of a period at least


def test_a_joint_at_rest_has_none() -> None:
    assert len(_frequency_grid(np.full(20, 0.1), "position")) == 0
    assert len(_frequency_grid(np.zeros(0), "time")) == 0
