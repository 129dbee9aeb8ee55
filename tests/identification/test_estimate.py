"""Least squares with intervals, on problems whose answer is known."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from orbisim.identification.estimate import PRIOR, estimate

BOUNDS = torch.tensor([1e-3, 1e-3, 1e-3]), torch.tensor([1e3, 1e3, 1e3])
TIME = torch.linspace(0.1, 2.0, 10, dtype=torch.float64)


def _decay(values: Tensor) -> Tensor:
    """Amplitude, rate, and a third that nothing depends on: [W, 10]."""
    return values[:, :1] * torch.exp(-values[:, 1:2] * TIME)


def _apart(seen: Tensor, noise: float) -> Callable[[Tensor], Tensor]:
    """Errors of copies of the windows."""
    return lambda v: (_decay(v) - torch.cat([seen] * (len(v) // len(seen)))) / noise


def test_many_problems_at_once() -> None:
    generator = torch.Generator().manual_seed(0)
    truth = torch.exp(torch.randn(40, 3, generator=generator, dtype=torch.float64) * 0.5)
    group = torch.arange(40).repeat_interleave(8)
    noise = 0.05 * torch.randn(320, 1, generator=generator, dtype=torch.float64)
    seen = _decay(truth[group]) * (1 + noise)
    found = estimate(_apart(seen, 0.05), torch.ones(40, 3).double(), BOUNDS, group, 25, 10)
    error = (found.values / truth - 1)[:, :2].abs()
    assert error.median() < 0.03
    inside = ((found.low <= truth) & (truth <= found.high))[:, 0].double().mean()
    assert 0.85 <= inside <= 1.0  # of an amplitude whose errors are those of whole windows
    assert (found.cost[:, -1] <= found.cost[:, 0]).all()
    # the third stays, as uncertain as the prior says
    torch.testing.assert_close(found.values[:, 2], torch.ones(40).double(), atol=1e-6, rtol=0)
    assert (found.high[:, 2] > 1.9 * math.log(PRIOR)).all()


def test_one_window_far_off_is_not_believed() -> None:
    truth = torch.tensor([[2.0, 1.0, 1.0]], dtype=torch.float64)
    group = torch.zeros(9, dtype=torch.long)
    seen = _decay(truth[group])
    seen[4] += 50.0
    found = estimate(_apart(seen, 0.05), torch.ones(1, 3).double(), BOUNDS, group, 25, 10)
    assert abs(float(found.values[0, 0]) - 2.0) < 0.02


def test_values_stay_within_bounds() -> None:
    group = torch.zeros(4, dtype=torch.long)
    low, high = torch.tensor([0.5, 0.5, 0.5]), torch.tensor([1.5, 1.5, 1.5])
    seen = _decay(torch.full((4, 3), 3.0).double())
    found = estimate(_apart(seen, 0.01), torch.ones(1, 3).double(), (low, high), group)
    assert float(found.values.max()) <= 1.5 + 1e-6 and float(found.values.min()) >= 0.5 - 1e-6


def test_a_scan_finds_the_deeper_of_two_minima() -> None:
    # of an amplitude alone: sin has its minimum at a phase of 5, and others a turn away
    seen = torch.sin(5.0 * TIME)[None]

    def residuals(values: Tensor) -> Tensor:
        return (torch.sin(values[:, :1] * TIME) - seen.expand(len(values), -1)) / 0.05

    group, start = torch.zeros(1, dtype=torch.long), torch.tensor([[2.0]], dtype=torch.float64)
    bounds = torch.tensor([0.1]), torch.tensor([20.0])
    alone = estimate(residuals, start, bounds, group, 25, 10)
    scanned = estimate(residuals, start, bounds, group, 25, 10, scan=16)
    assert abs(float(alone.values) - 5.0) > 0.5
    assert abs(float(scanned.values) - 5.0) < 0.01
    assert scanned.cost[0, -1] < alone.cost[0, -1]


def test_a_prior_of_its_own_is_kept_where_nothing_shows_and_weighed_where_something_does() -> None:
    group = torch.arange(2).repeat_interleave(6)
    truth = torch.tensor([[2.0, 1.0, 1.0]], dtype=torch.float64).repeat(2, 1)
    start = torch.tensor([[1.0, 1.0, 7.0]], dtype=torch.float64).repeat(2, 1)
    # of the first problem the amplitude is thought to be known, of the second it is not
    spread = torch.tensor([[0.001, 1.5, 0.2], [1.5, 1.5, 0.2]], dtype=torch.float64)
    found = estimate(_apart(_decay(truth[group]), 0.2), start, BOUNDS, group, 25, 10, spread=spread)
    assert float(found.values[0, 0]) < 1.02 and abs(float(found.values[1, 0]) - 2.0) < 0.1
    torch.testing.assert_close(
        found.values[:, 2], torch.full((2,), 7.0).double(), rtol=0, atol=1e-6
    )
    width = (found.high / found.values).log()[:, 2]
    assert ((width > 1.9 * 0.2) & (width < 4.0 * 0.2)).all()  # not the factor of 4.5 either way
