from __future__ import annotations

import numpy as np
import pytest
import torch
from orbisim_policies.suite import SUITE, SuiteProblem

from orbisim import suite


@pytest.mark.parametrize("task", SUITE)
def test_the_reward_is_dm_controls(task: str) -> None:
    domain, name = suite.split_name(task)
    environment = suite.load(domain, name, task_kwargs={"random": 3})
    problem, rng = SuiteProblem(task, steps=40), np.random.default_rng(0)
    first = environment.reset()
    start = problem.draw([3])
    np.testing.assert_array_equal(start.qpos[0], environment.physics.data.qpos)
    assert first.observation
    score = problem.begin(*(torch.tensor(f) for f in (start.qpos, start.qvel, start.command)))
    total = 0.0
    for _ in range(40):
        action = rng.uniform(-1, 1, problem.actions)
        total += environment.step(action).reward / 40
        data = environment.physics.data
        fields = (data.qpos, data.qvel, data.ctrl)
        qpos, qvel, control = (torch.tensor(np.array(f))[None] for f in fields)
        score = problem.count(score, qpos, qvel, control)
    assert float(problem.measure(score, qpos)) == pytest.approx(total, abs=1e-12)


def test_what_is_learned_from_has_a_gradient_everywhere() -> None:
    task = SUITE["pendulum-swingup"]
    qpos = torch.tensor([[2.0]], requires_grad=True)
    task.smooth(qpos, torch.zeros(1, 1), torch.zeros(1, 1)).sum().backward()
    assert abs(float(qpos.grad)) > 0.01
    assert float(task.smooth(torch.zeros(1, 1), torch.zeros(1, 1), torch.zeros(1, 1))) == 1.0
