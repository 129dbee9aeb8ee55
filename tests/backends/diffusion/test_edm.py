"""The diffusion process: identities of its equations, and sampling where the answer is known."""

from __future__ import annotations

import pytest
import torch
from orbisim_diffusion import edm

SIGMA = torch.tensor([0.01, 0.5, 3.0, 70.0])


def test_inputs_targets_and_weights_have_unit_size() -> None:
    """Karras et al.: c_in makes the input, c_out the target of unit variance; w undoes c_out."""
    data = 0.7
    variance = data**2 + SIGMA**2
    torch.testing.assert_close(edm.c_in(SIGMA, data) ** 2 * variance, torch.ones(4))
    skip, out = edm.c_skip(SIGMA, data), edm.c_out(SIGMA, data)
    target = ((1 - skip) ** 2 * data**2 + skip**2 * SIGMA**2) / out**2
    torch.testing.assert_close(target, torch.ones(4))
    torch.testing.assert_close(edm.weight(SIGMA, data) * out**2, torch.ones(4))


def test_a_perfect_denoiser_has_no_loss_and_a_bad_one_its_square() -> None:
    y = torch.randn(3, 2, 4, 4)
    sigma = torch.tensor([0.1, 1.0, 10.0])
    assert edm.denoising_loss(y, y, sigma, 1.0) == 0
    expected = (edm.weight(sigma, 1.0) * 0.25).mean()
    torch.testing.assert_close(edm.denoising_loss(y + 0.5, y, sigma, 1.0), expected)


@pytest.mark.parametrize("steps", [1, 2, 4, 8, 18])
def test_a_sampler_that_knows_the_answer_finds_it(steps: int) -> None:
    levels = edm.levels(steps, torch.device("cpu"))
    assert len(levels) == steps + 1
    assert (levels.diff() < 0).all()
    assert levels[-1] == 0
    answer, calls = torch.randn(2, 3, 4, 4), []

    def denoise(y: torch.Tensor, sigma: torch.Tensor) -> torch.Tensor:
        calls.append(float(sigma[0]))
        return answer

    found = edm.sample(denoise, torch.randn(2, 3, 4, 4), steps)
    torch.testing.assert_close(found, answer)
    assert len(calls) == steps


def test_many_steps_give_samples_of_the_distribution() -> None:
    """For data N(2, 0.5^2) the best denoiser is known; samples have that mean and deviation."""
    torch.manual_seed(0)

    def denoise(y: torch.Tensor, sigma: torch.Tensor) -> torch.Tensor:
        s = sigma[:, None, None, None] ** 2
        return (0.25 * y + s * 2.0) / (0.25 + s)

    found = edm.sample(denoise, torch.randn(4000, 1, 1, 1), 100)
    assert float(found.mean()) == pytest.approx(2.0, abs=0.03)
    assert float(found.std()) == pytest.approx(0.5, abs=0.03)


def test_noise_levels_lie_where_they_should() -> None:
    torch.manual_seed(0)
    sigma = edm.draw_sigma(4000, 0.4, 1.6, torch.device("cpu"))
    assert float(sigma.log().median()) == pytest.approx(0.4, abs=0.1)
    assert sigma.min() >= edm.SIGMA_MIN
    assert sigma.max() <= edm.SIGMA_MAX
    anchor = edm.draw_anchor_noise(4000, 0.01, 0.3, torch.device("cpu"))
    assert 0.01 <= float(anchor.min()) <= float(anchor.max()) <= 0.3
    assert float(anchor.log().mean()) == pytest.approx(-2.905, abs=0.05)
