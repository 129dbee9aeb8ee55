from __future__ import annotations

import pytest
import torch
from orbisim_policies.learned import LearnedWorlds
from orbisim_policies.network import NetworkConfig, Policy
from orbisim_policies.rollout import _Limit, advanced, began, observation, play, worth
from orbisim_policies.suite import SuiteProblem


def test_the_gradient_of_an_episode_is_that_of_finite_differences(
    cartpole: SuiteProblem, cartpole_worlds: LearnedWorlds
) -> None:
    torch.manual_seed(0)
    pool = cartpole_worlds.pool(cartpole.draw([1, 2]))
    policy = Policy(cartpole.observations, 1, NetworkConfig((8,)))

    def objective() -> torch.Tensor:
        now = began(cartpole_worlds, pool)
        for _ in range(cartpole.steps):
            now = advanced(cartpole_worlds, now, policy(observation(cartpole_worlds, now)), 0.0)
        return worth(cartpole_worlds, now).sum()

    objective().backward()
    weight = policy.head.bias
    exact, step = float(weight.grad), 2e-2
    values = []
    for sign in (1, -1):
        with torch.no_grad():
            weight += sign * step
            values.append(float(objective()))
            weight -= sign * step
    assert exact == pytest.approx((values[0] - values[1]) / (2 * step), rel=0.05, abs=1e-6)


def test_playing_is_the_same_without_gradients(
    cartpole: SuiteProblem, cartpole_worlds: LearnedWorlds
) -> None:
    pool = cartpole_worlds.pool(cartpole.draw([1]))
    policy = Policy(cartpole.observations, 1, NetworkConfig((8,)))
    now = play(cartpole_worlds, policy, pool)
    assert float(now.done) == cartpole.steps and not now.score.requires_grad


def test_gradients_are_shortened_world_by_world_and_lost_ones_forgotten() -> None:
    x = torch.zeros(3, 2, requires_grad=True)
    (y,) = _Limit.apply(1.0, x)
    y.backward(torch.tensor([[3.0, 4.0], [0.3, 0.4], [float("nan"), 1.0]]))
    expected = torch.tensor([[0.6, 0.8], [0.3, 0.4], [0.0, 0.0]])
    assert x.grad is not None and torch.allclose(x.grad, expected, atol=1e-6)
