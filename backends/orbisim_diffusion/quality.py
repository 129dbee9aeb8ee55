"""How alike images and videos are: PSNR, SSIM, and distances of EfficientNet-Lite0's features."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

_WINDOW, _SIGMA = 11, 1.5
_C1, _C2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
"""Window and constants of SSIM (Wang et al. 2004)."""


def psnr(a: Tensor, b: Tensor) -> Tensor:
    """Peak signal-to-noise ratio, dB, of uint8 images [..., H, W, 3]; one for each image."""
    error = (a.float() - b.float()).square().mean((-1, -2, -3))
    return 10.0 * torch.log10(255.0**2 / error.clamp_min(1e-6))


def ssim(a: Tensor, b: Tensor) -> Tensor:
    """Structural similarity (Wang et al. 2004) of uint8 images [N, H, W, 3]; one for each image.

    By channel with a Gaussian window of 11 pixels, over windows that lie inside the image.
    """
    kernel = _gaussian(a.device)

    def smooth(x: Tensor) -> Tensor:
        return torch.nn.functional.conv2d(x, kernel, groups=3)

    x, y = (image.float().movedim(-1, -3) for image in (a, b))
    mx, my = smooth(x), smooth(y)
    xx, yy, xy = smooth(x * x) - mx * mx, smooth(y * y) - my * my, smooth(x * y) - mx * my
    value = ((2 * mx * my + _C1) * (2 * xy + _C2)) / ((mx**2 + my**2 + _C1) * (xx + yy + _C2))
    return value.mean((1, 2, 3))


def _gaussian(device: torch.device) -> Tensor:
    x = torch.arange(_WINDOW, device=device) - _WINDOW // 2
    row = torch.exp(-0.5 * (x / _SIGMA) ** 2)
    window = row[:, None] * row
    return (window / window.sum()).expand(3, 1, -1, -1)


def frechet(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> float:
    """Frechet distance between Gaussians fitted to features [N, D] and [M, D].

    |m1 - m2|^2 + tr(C1 + C2 - 2 (C1 C2)^(1/2)), the trace of the root by eigenvalues.
    """
    ca, cb = np.cov(a, rowvar=False), np.cov(b, rowvar=False)
    values = np.linalg.eigvals(ca @ cb)
    root = np.sqrt(np.maximum(values.real, 0.0)).sum()
    return float(np.square(a.mean(0) - b.mean(0)).sum() + np.trace(ca) + np.trace(cb) - 2.0 * root)
