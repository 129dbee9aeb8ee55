from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

pytest.importorskip("stable_baselines3")

from orbisim_policies import learner_state
from orbisim_policies.baselines import Baseline, ProblemVecEnv, _learner
from orbisim_policies.network import NetworkConfig
from orbisim_policies.successive import SuccessiveEpisodes
from orbisim_policies.suite import SuiteProblem


def drawn(learner: Any) -> list[Any]:
    """The next of all random numbers that the library draws."""
    shuffled = np.random.permutation(9)  # noqa: NPY002
    return [shuffled, torch.rand(3), learner.action_space.sample()]


@pytest.mark.parametrize(("method", "returns"), [("sac", 1), ("sac", 4), ("ppo", 1)])
def test_a_fresh_learner_takes_all_of_another(
    cartpole: SuiteProblem, method: str, returns: int
) -> None:
    config = Baseline(method, batch=2, window=64, returns=returns, network=NetworkConfig((8,)))
    environment = ProblemVecEnv(SuccessiveEpisodes(cartpole, 2, cartpole.draw([1, 2]), nthread=1))
    first, _ = _learner(config, environment, 0)
    first.learn(128)
    tensors, notes = learner_state.state_of(first)
    numbers = drawn(first)
    second, _ = _learner(config, environment, 7)
    learner_state.restore(second, tensors, notes)
    for one, other in zip(numbers, drawn(second), strict=True):
        np.testing.assert_array_equal(one, other)
    if returns > 1:
        assert second.replay_buffer.n_steps == returns
    found, kept = learner_state.state_of(second)
    assert found.keys() == tensors.keys() and kept["timesteps"] == 128
    for name, tensor in tensors.items():
        if not name.startswith("random/"):
            assert torch.equal(found[name], tensor), name
    assert any("optimizer" in name for name in tensors)
    environment.close()


def test_what_is_of_another_learner_is_refused(cartpole: SuiteProblem) -> None:
    environment = ProblemVecEnv(SuccessiveEpisodes(cartpole, 2, cartpole.draw([1, 2]), nthread=1))
    made = [
        _learner(Baseline("ppo", batch=2, window=64, network=NetworkConfig((n,))), environment, 0)
        for n in (8, 4)
    ]
    made[0][0].learn(128)
    with pytest.raises(RuntimeError, match="size"):
        learner_state.restore(made[1][0], *learner_state.state_of(made[0][0]))
    environment.close()
