from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from orbisim_policies.apg import Apg, ApgConfig
from orbisim_policies.checkpoint import load_policy
from orbisim_policies.differenced import DifferencedWorlds
from orbisim_policies.network import NetworkConfig
from orbisim_policies.problems import make_problem
from orbisim_policies.push import PushProblem
from orbisim_policies.rollout import advanced, began, worth
from orbisim_policies.run import Run, train_apg
from orbisim_policies.suite import SuiteProblem
from orbisim_policies.true import TrueWorlds

from orbisim.errors import InputError

SMALL = ApgConfig(batch=4, horizon=4, network=NetworkConfig((16,)))


def test_its_step_is_that_of_the_true_worlds(cartpole: SuiteProblem) -> None:
    starts = cartpole.draw([1, 2])
    worlds, true = DifferencedWorlds(cartpole, 1), TrueWorlds(cartpole, 2, 1)
    true.begin(np.arange(2), starts)
    now = began(worlds, worlds.pool(starts))
    action = torch.tensor([[0.7], [-0.4]])
    for _ in range(3):
        now = advanced(worlds, now, action, 0.0)
        true.step(action)
    for found, expected in zip(worlds.coordinates(now.x), true.coordinates, strict=True):
        np.testing.assert_allclose(found.numpy(), expected, atol=1e-5)  # states in float32
    true.close()


def test_its_gradient_is_the_slope_of_the_reward(cartpole: SuiteProblem) -> None:
    worlds = DifferencedWorlds(cartpole, 1)
    pool = worlds.pool(cartpole.draw([3]))

    def value(action: torch.Tensor) -> torch.Tensor:
        now = began(worlds, pool)
        for _ in range(4):
            now = advanced(worlds, now, action, 0.0)
        return now.x.v[:, 1].sum() + worth(worlds, now).sum()

    action = torch.full((1, 1), 0.2, requires_grad=True)
    value(action).backward()
    assert action.grad is not None
    slope = (value(torch.tensor([[0.3]])) - value(torch.tensor([[0.1]]))) / 0.2
    assert abs(float(slope)) > 1e-2
    assert float(action.grad) == pytest.approx(float(slope), rel=0.02)


def test_a_world_that_diverges_is_left_out(cartpole: SuiteProblem) -> None:
    worlds = DifferencedWorlds(cartpole, 1)
    pool = worlds.pool(cartpole.draw(range(2)))
    pool.qvel[0] = 1e12  # MuJoCo calls that diverged
    training = Apg(worlds, pool, SMALL)
    before = training.optimizer.values.clone()
    found = training.step(0.0)
    assert 0.0 < float(found[1]) < 1.0 and found.isfinite().all()
    assert not torch.equal(training.optimizer.values, before)
    assert training.optimizer.values.isfinite().all()


def test_steps_of_the_differences_are_counted(cartpole: SuiteProblem, tmp_path: Path) -> None:
    run = Run(tmp_path / "p", steps=2, starts=4, check=0, nthread=1)
    manifest = train_apg(cartpole, SMALL, run, differences=True)
    # two positions, two velocities, a control: ten steps beside each
    assert manifest["true_steps"] == 2 * 4 * 4 * 11
    assert manifest["dynamics"] == "mujoco"
    load_policy(tmp_path / "p", cartpole)


def test_scenes_that_differ_are_refused(push: PushProblem) -> None:
    with pytest.raises(InputError, match="scenes of their own"):
        DifferencedWorlds(push)


def test_every_task_of_the_suite_has_gradients() -> None:
    for name in ("acrobot-swingup", "cheetah-run", "pendulum-swingup", "reacher-easy"):
        problem = make_problem(f"suite:{name}", 4)
        worlds = DifferencedWorlds(problem, 1)
        training = Apg(worlds, worlds.pool(problem.draw(range(2))), SMALL)
        assert training.step(0.0).isfinite().all()
        assert float(training.optimizer.skipped) == 0.0
