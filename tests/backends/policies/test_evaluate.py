from __future__ import annotations

import numpy as np
import pytest
import torch
from orbisim_policies.evaluate import evaluate, in_mujoco, starts_of, wilson
from orbisim_policies.learned import LearnedWorlds
from orbisim_policies.network import NetworkConfig, Policy
from orbisim_policies.suite import SuiteProblem


def test_the_interval_is_wilsons() -> None:
    low, high = wilson(41, 96)  # the paper's 42.71 %
    assert (low, high) == (pytest.approx(0.3327, abs=1e-3), pytest.approx(0.5271, abs=1e-3))
    assert wilson(0, 10)[0] == 0.0 and wilson(10, 10)[1] == 1.0


def test_episodes_of_evaluation_and_training_differ(cartpole: SuiteProblem) -> None:
    a, b = (starts_of(cartpole, 3, 0, purpose).qpos for purpose in ("evaluation", "checks"))
    assert not np.array_equal(a, b)
    np.testing.assert_array_equal(a, starts_of(cartpole, 3, 0).qpos)


def test_success_in_mujoco_stands_beside_success_in_the_model(
    cartpole: SuiteProblem, cartpole_worlds: LearnedWorlds
) -> None:
    policy = Policy(cartpole.observations, 1, NetworkConfig((4,)))
    found = evaluate(cartpole, policy, episodes=2, seeds=(0, 1), worlds=cartpole_worlds, nthread=1)
    assert found["mujoco"]["episodes"] == 4 and len(found["by_seed"]) == 2
    true, inside = (found[side]["reward"]["return"]["mean"] for side in ("mujoco", "model"))
    assert true == pytest.approx(inside, abs=0.01)
    each = [seed["reward"]["return"]["mean"] for seed in found["by_seed"]]
    assert np.mean(each) == pytest.approx(true)
    assert found["mujoco"]["success"]["return"]["ci95"][1] > 0.4  # of 0 of 4


def test_a_policy_that_says_nothing_finite_ends_its_episodes(cartpole: SuiteProblem) -> None:
    def act(view: torch.Tensor) -> torch.Tensor:
        action = torch.zeros(len(view), 1)
        action[0] = float("nan")
        return action

    starts = starts_of(cartpole, 3, 0)
    end, value, lost = in_mujoco(cartpole, act, starts, nthread=1)
    assert lost == 1 and value[0] == 0.0 and np.isfinite(value).all()
    np.testing.assert_array_equal(end[0], starts.qpos[0])
    assert (end[1:] != starts.qpos[1:]).any()


def test_an_episode_whose_reward_is_no_number_has_failed(
    cartpole: SuiteProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(score: torch.Tensor, qpos: torch.Tensor) -> torch.Tensor:
        return torch.tensor([[0.9], [float("nan")], [0.2]])

    monkeypatch.setattr(cartpole, "measure", broken)
    starts = starts_of(cartpole, 3, 0)
    _, value, lost = in_mujoco(cartpole, lambda view: torch.zeros(3, 1), starts, nthread=1)
    assert lost == 1 and value[:, 0].tolist() == pytest.approx([0.9, 0.0, 0.2])
