"""How far windows reach."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np

from orbisim.shooting.cutting import wrongly_lost
from orbisim.shooting.shooter import Variant
from orbisim.shooting.windows import Windows


class _Far(SimpleNamespace):
    """What a shooter is asked for windows that end early."""

    def __len__(self) -> int:
        return len(self.left)

    def simulate(self, variant: Variant, start: np.ndarray) -> None:
        assert start.shape == (len(self), 2)

    def residual(self, simulated: None) -> np.ndarray:
        return np.asarray(self.left)


def test_impacts_that_never_happened_cut_no_window_short() -> None:
    horizon = np.array([[10, 0], [3, 0], [2, 0], [4, 0]])
    windows = Windows(np.arange(4), 10, np.zeros(4, int), horizon)
    noise = (np.array([1e-3]), np.array([np.nan]))
    left = np.array([[1.0], [500.0], [300.0], [2.0]])
    shooter: Any = _Far(nv=1, declared=None, left=left)
    found = wrongly_lost(shooter, windows, noise)
    assert found.horizon is not None
    np.testing.assert_array_equal(found.horizon[:, 0], [10, 10, 10, 4])
    np.testing.assert_array_equal(found.horizon[:, 1], 0)  # no velocity is measured
    near: Any = _Far(nv=1, declared=None, left=left / 100)
    assert wrongly_lost(near, windows, noise) is windows
    few = dataclasses.replace(windows, horizon=np.array([[10, 0], [10, 0], [2, 0], [10, 0]]))
    assert wrongly_lost(shooter, few, noise) is few
