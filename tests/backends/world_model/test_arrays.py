"""Between a state's arrays and tensors."""

from __future__ import annotations

import numpy as np
import torch
from orbisim_world_model.arrays import has_gradient, later, like, tensor


def test_there_and_back() -> None:
    array = np.array([[1.0, 2.5]])
    moved = tensor(array, "cpu")
    assert moved.dtype == torch.float32
    back = like(moved, array)
    assert isinstance(back, np.ndarray)
    assert back.dtype == np.float64
    np.testing.assert_array_equal(back, array)
    double = torch.ones(2, dtype=torch.float64)
    assert like(moved, double).dtype == torch.float64


def test_gradients_are_kept() -> None:
    source = torch.ones(2, dtype=torch.float64, requires_grad=True)
    moved = tensor(source, "cpu")
    assert has_gradient(moved)
    kept = like(moved, np.ones(2))
    assert isinstance(kept, torch.Tensor)
    kept.sum().backward()
    assert source.grad is not None
    assert not has_gradient(np.ones(2))
    assert not has_gradient(torch.ones(2))


def test_times_afterwards() -> None:
    for time in (np.array([1.0, 2.0]), torch.tensor([1.0, 2.0], dtype=torch.float64)):
        assert np.asarray(later(time, 0.5)).tolist() == [1.5, 2.5]
        both = later(time, np.array([0.25, 0.5, 0.75]))
        assert np.asarray(both).tolist() == [[1.25, 1.5, 1.75], [2.25, 2.5, 2.75]]
