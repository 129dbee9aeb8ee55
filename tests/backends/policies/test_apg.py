from __future__ import annotations

import dataclasses
from typing import Any

import pytest
import torch
from orbisim_policies.apg import Apg, ApgConfig
from orbisim_policies.learned import LearnedWorlds
from orbisim_policies.network import NetworkConfig
from orbisim_policies.push import PushProblem
from orbisim_policies.suite import SuiteProblem
from torch.utils._python_dispatch import TorchDispatchMode

from orbisim.errors import InputError

SMALL = ApgConfig(batch=4, network=NetworkConfig((16,)))


@pytest.mark.parametrize("horizon", [0, 4])
def test_it_improves_and_goes_on_exactly(
    cartpole: SuiteProblem, cartpole_worlds: LearnedWorlds, horizon: int
) -> None:
    pool = cartpole_worlds.pool(cartpole.draw(range(4)))
    config = dataclasses.replace(SMALL, horizon=horizon, rate=1e-2)
    first = Apg(cartpole_worlds, pool, config, seed=1)
    begun = [first.step(0.1 * i)[0] for i in range(3)]
    kept = {name: tensor.clone() for name, tensor in first.state().items()}
    rest = [first.step(0.1 * i) for i in (3, 4)]
    second = Apg(cartpole_worlds, pool, config, seed=1)
    second.restore(kept, 3)
    for expected, step in zip(rest, (3, 4), strict=True):
        assert torch.equal(second.step(0.1 * step), expected)
    after = second.state()
    assert all(torch.equal(tensor, after[name]) for name, tensor in first.state().items())
    assert begun[0].isfinite()


def test_a_policy_learns_to_reach(push: PushProblem, push_worlds: LearnedWorlds) -> None:
    pool = push_worlds.pool(push.draw([1]))
    config = dataclasses.replace(SMALL, batch=2, rate=1e-2, final_rate=1e-2, noise=0.0)
    training = Apg(push_worlds, pool, dataclasses.replace(config, final_noise=0.0), seed=0)
    rewards = [float(training.step(0.0)[3]) for _ in range(8)]  # r1 of the same start
    assert rewards[-1] > rewards[0] + 0.1


def test_a_world_without_a_finite_reward_is_left_out(
    cartpole: SuiteProblem, cartpole_worlds: LearnedWorlds
) -> None:
    pool = cartpole_worlds.pool(cartpole.draw(range(2)))
    pool.qpos[0] = float("nan")
    for horizon in (0, 4):
        config = dataclasses.replace(SMALL, batch=16, horizon=horizon)
        training = Apg(cartpole_worlds, pool, config)
        before = training.optimizer.values.clone()
        found = training.step(0.0)
        assert 0.0 < float(found[1]) < 1.0 and found.isfinite().all()
        assert training.optimizer.values.isfinite().all()
        assert float(training.optimizer.skipped) == 0.0
        assert not torch.equal(training.optimizer.values, before)


def test_a_horizon_that_does_not_divide_the_episode_is_refused(
    cartpole: SuiteProblem, cartpole_worlds: LearnedWorlds
) -> None:
    pool = cartpole_worlds.pool(cartpole.draw([0]))
    with pytest.raises(InputError, match="divides"):
        Apg(cartpole_worlds, pool, dataclasses.replace(SMALL, horizon=3))


class FromHost(TorchDispatchMode):
    """Notes the operations that a CUDA graph cannot record: they read or write the host's memory.

    Attributes:
      found: their names.
    """

    def __init__(self) -> None:
        super().__init__()
        self.found: set[str] = set()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = str(func)
        if any(part in name for part in ("lift_fresh", "_local_scalar_dense", "nonzero")):
            self.found.add(name)
        return func(*args, **(kwargs or {}))


@pytest.mark.parametrize("dynamics", ["push", "push_contacts"])
@pytest.mark.parametrize("horizon", [0, 1])
def test_an_iteration_stays_on_the_device(push: PushProblem, dynamics: str, horizon: int) -> None:
    worlds = LearnedWorlds(push, dynamics, torch.device("cpu"))
    training = Apg(worlds, worlds.pool(push.draw([1])), dataclasses.replace(SMALL, horizon=horizon))
    with FromHost() as watch:
        training._iterate()
    assert not watch.found


@pytest.mark.slow
@pytest.mark.timeout(900)  # torch's compiler takes minutes on a core that others share
def test_a_compiled_step_is_the_same_step(
    cartpole: SuiteProblem, cartpole_worlds: LearnedWorlds
) -> None:
    pool = cartpole_worlds.pool(cartpole.draw(range(2)))
    plain, fast = (
        Apg(cartpole_worlds, pool, SMALL, compiled=compiled) for compiled in (False, True)
    )
    for step in range(2):
        first, second = (training.step(0.1 * step) for training in (plain, fast))
        assert torch.allclose(first, second, atol=1e-5)
    assert torch.allclose(plain.optimizer.values, fast.optimizer.values, atol=1e-5)
