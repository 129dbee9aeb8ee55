"""Losses: stop-gradients, zeros where they belong, the paper's averages."""

from __future__ import annotations

import math

import pytest
import torch
from orbisim_world_model.config import Stage
from orbisim_world_model.losses import (
    encoding_loss,
    measure_scales,
    object_loss,
    robot_loss,
    scaled_state_loss,
    state_loss,
    transition_loss,
)
from orbisim_world_model.rotation import exponential, geodesic_distance, multiply, to_matrix
from orbisim_world_model.unroll import autoregressive_ratio

from tests.backends.world_model.synthetic import TABLE, simulate


def test_the_transition_loss_moves_the_prediction_alone() -> None:
    predicted, latent = (torch.randn(4, 3, 8, requires_grad=True) for _ in range(2))
    transition_loss(predicted, latent).backward()
    assert predicted.grad is not None and predicted.grad.abs().sum() > 0
    assert latent.grad is None


def test_the_encoding_loss_moves_the_encoding_alone() -> None:
    predicted, latent = (torch.randn(4, 3, 8, requires_grad=True) for _ in range(2))
    encoding_loss(predicted, latent).backward()
    assert latent.grad is not None and latent.grad.abs().sum() > 0
    assert predicted.grad is None


def test_both_are_the_squared_distance() -> None:
    a, b = torch.zeros(2, 1, 4), torch.full((2, 1, 4), 0.5)
    assert float(transition_loss(a, b)) == pytest.approx(0.25)
    assert float(encoding_loss(a, b)) == pytest.approx(0.25)


def test_the_state_loss_is_zero_for_the_truth_and_ignores_quaternion_signs() -> None:
    pack = simulate(TABLE, 2, 5, 4)
    x, mask = pack.states(torch.arange(6)), torch.ones(6, 2)
    flipped = x._replace(quat=-x.quat)
    context, short = (pack.context(torch.zeros(n, dtype=torch.long)) for n in (6, 5))
    assert float(state_loss(flipped, x, mask, pack.layout).max()) < 1e-5
    scales = measure_scales(x.at(slice(0, 5)), x.at(slice(1, 6)), short, pack.layout)
    assert float(scaled_state_loss(flipped, x, context, pack.layout, scales).max()) < 0.05


def test_robot_and_object_parts() -> None:
    pack = simulate(TABLE, 2, 5, 4)
    x, mask = pack.states(torch.arange(6)), torch.ones(6, 2)
    moved = x._replace(pos=x.pos + torch.tensor([0.1, 0.0, 0.0]))
    assert torch.allclose(object_loss(moved, x, mask), torch.tensor(0.5 * 0.01 / 3), atol=1e-6)
    assert float(robot_loss(moved, x, pack.layout).max()) < 1e-5
    turned = x._replace(
        quat=multiply(exponential(torch.tensor([0.0, 0.0, 0.4]).expand(6, 2, 3)), x.quat)
    )
    assert torch.allclose(
        object_loss(turned, x, mask), torch.tensor(1 - math.cos(0.2) ** 2), atol=1e-5
    )


def test_objects_are_averaged_over_those_that_are_there() -> None:
    pack = simulate(TABLE, 2, 5, 4)
    x = pack.states(torch.arange(6))
    shift = torch.zeros(6, 2, 3)
    shift[:, 1] = 5.0  # padding may hold anything
    moved = x._replace(pos=x.pos + shift)
    alone = torch.tensor([[1.0, 0.0]]).expand(6, 2)
    assert float(object_loss(moved, x, alone).max()) < 1e-6
    assert float(object_loss(moved, x, torch.ones(6, 2)).min()) > 1.0


@pytest.mark.parametrize("angle", [0.0, 1e-4, 0.3, 3.0])
def test_the_geodesic_distance_is_the_angle(angle: float) -> None:
    vector = torch.tensor([[0.6, 0.0, 0.8]]) * angle
    vector.requires_grad_(True)
    distance = geodesic_distance(to_matrix(exponential(vector)), torch.eye(3)[None])
    assert float(distance.detach()) == pytest.approx(angle, abs=2e-3)
    distance.sum().backward()
    assert torch.isfinite(vector.grad).all()


def test_the_ratio_follows_the_cosine() -> None:
    stage = Stage(1.0, 4, 8, autoregressive=True)
    assert [autoregressive_ratio(stage, p) for p in (0.0, 0.5, 1.0)] == pytest.approx([0, 0.5, 1])
    assert autoregressive_ratio(Stage(1.0, 4, 8), 0.7) == 0.0


@pytest.mark.parametrize("extended", [True, False])
def test_the_scaled_loss_is_of_what_the_state_has(extended: bool) -> None:
    """The paper's state has the hand's velocity, the extended one joints and spins in its place."""
    pack = simulate(TABLE, 2, 6, 4)
    row, episode = pack.transitions()
    x, after, context = pack.states(row), pack.states(row + 1), pack.context(episode)
    scales = measure_scales(x, after, context, pack.layout)
    moved = type(x)(*(field.clone().requires_grad_() for field in x))
    loss = scaled_state_loss(moved, after, context, pack.layout, scales, 0.3, extended).sum()
    names = ("q", "v", "hand", "pos", "vel", "ang")
    slopes = torch.autograd.grad(loss, [getattr(moved, n) for n in names], allow_unused=True)
    felt = dict(zip(names, slopes, strict=True))
    assert all((felt[n] is not None) == extended for n in ("q", "v", "ang"))
    assert all(felt[n].abs().sum() > 0 for n in ("pos", "vel"))
    hand = felt["hand"].abs().sum(0)
    assert hand[:3].sum() > 0
    assert bool(hand[12:15].sum() > 0) != extended
    if not extended:  # the same errors in SI units and in those of a step, by hand
        off = smooth_l1((moved.hand_vel - after.hand_vel) / scales.hand[2], 0.3).mean(-1)
        still = moved._replace(hand=torch.cat([moved.hand[:, :12], after.hand[:, 12:]], 1))
        rest = scaled_state_loss(still, after, context, pack.layout, scales, 0.3, extended)
        whole = scaled_state_loss(moved, after, context, pack.layout, scales, 0.3, extended)
        torch.testing.assert_close(whole - rest, off, atol=1e-5, rtol=1e-4)


def smooth_l1(error: torch.Tensor, beta: float) -> torch.Tensor:
    size = error.abs()
    return torch.where(size < beta, 0.5 * size**2 / beta, size - 0.5 * beta)
