"""Between the arrays of a `State` (NumPy or torch) and tensors on the device."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from orbisim.state import Array


def tensor(array: Array, device: Any) -> Tensor:
    """The array in float32 on the device; gradients are kept."""
    if isinstance(array, Tensor):
        return array.to(device=device, dtype=torch.float32)
    return torch.as_tensor(np.asarray(array, np.float32), device=device)


def like(values: Tensor, reference: Array) -> Array:
    """The values as the same kind of array as the reference; tensors with gradients stay torch."""
    if isinstance(reference, Tensor):
        return values.to(device=reference.device, dtype=reference.dtype)
    if values.requires_grad:
        return values
    return values.detach().cpu().numpy().astype(np.float64)


def has_gradient(array: Array) -> bool:
    """Whether gradients flow through the array."""
    return isinstance(array, Tensor) and array.requires_grad


def later(time: Array, seconds: Any) -> Array:
    """Times [nworld] after so many seconds [...]: [nworld, ...]."""
    if isinstance(time, Tensor):
        return time.reshape(-1, *([1] * np.ndim(seconds))) + torch.as_tensor(
            seconds, dtype=time.dtype, device=time.device
        )
    return np.asarray(time).reshape(-1, *([1] * np.ndim(seconds))) + seconds
