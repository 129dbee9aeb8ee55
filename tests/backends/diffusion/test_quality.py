"""Measures of likeness where the answer is known."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from orbisim_diffusion.quality import frechet, psnr, ssim


def images(seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 200, (2, 24, 24, 3), generator=generator, dtype=torch.uint8)


def test_psnr_of_a_known_error() -> None:
    a = images()
    expected = 20 * np.log10(255 / 10)
    torch.testing.assert_close(psnr(a, a + 10), torch.full((2,), float(expected)))


def test_ssim_of_equal_brighter_and_unrelated_images() -> None:
    a = images()
    torch.testing.assert_close(ssim(a, a), torch.ones(2))
    brighter = ssim(a, a + 40)
    assert 0.8 < float(brighter.min()) <= float(brighter.max()) < 1.0
    assert ssim(a, images(1)).abs().max() < 0.2


def test_ssim_of_flat_images_is_its_luminance_term() -> None:
    a, b = (torch.full((1, 16, 16, 3), v, dtype=torch.uint8) for v in (100, 150))
    c1 = (0.01 * 255) ** 2
    expected = (2 * 100 * 150 + c1) / (100**2 + 150**2 + c1)
    assert float(ssim(a, b)) == pytest.approx(expected, abs=1e-3)


def test_frechet_distance_of_gaussians() -> None:
    rng = np.random.default_rng(0)
    a = rng.normal(0.0, 1.0, (40000, 2))
    b = rng.normal([1.0, 2.0], [1.0, 3.0], (40000, 2))
    assert frechet(a, b) == pytest.approx(1 + 4 + (3 - 1) ** 2, rel=0.05)
    assert frechet(a, a) == pytest.approx(0.0, abs=1e-6)
