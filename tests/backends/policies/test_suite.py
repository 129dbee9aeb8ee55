from __future__ import annotations

import numpy as np
import pytest
import torch
from orbisim_policies.problem import Moment
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


@pytest.mark.parametrize("task", SUITE)
def test_what_is_learned_from_has_a_gradient(task: str) -> None:
    problem = SuiteProblem(task, steps=1)
    starts = problem.draw([4])
    fields = (starts.qpos, starts.qvel, starts.command)
    qpos, qvel, command = (torch.tensor(field, requires_grad=True) for field in fields)
    score = problem.begin(qpos, qvel, command)
    problem.count(score, qpos, qvel, torch.zeros(1, problem.actions))[:, 0].sum().backward()
    slopes = [field.grad for field in (qpos, qvel) if field.grad is not None]
    assert max(float(slope.abs().max()) for slope in slopes) > 1e-3


def test_a_pendulum_that_stands_is_worth_most() -> None:
    _, smooth = SUITE["pendulum-swingup"].rewards(SuiteProblem("pendulum-swingup").scene.model)
    still = torch.zeros(1, 1)
    assert float(smooth(still, still, still, still)) == 1.0


def test_a_goal_stands_in_the_scene_that_is_shown() -> None:
    problem = SuiteProblem("reacher-easy", steps=3)
    scene, starts = problem.trials(2, 5)
    goal = scene.model.geom("target").pos[:2]
    np.testing.assert_allclose(starts.command, [goal, goal])
    assert (problem.draw([6]).command[0] != goal).any()
    moment = Moment(
        *(torch.as_tensor(f).float() for f in (starts.qpos, starts.qvel, starts.command)),
        torch.zeros(2, 0),
        torch.zeros(2, 4),
        torch.zeros(2),
    )
    assert problem.observe(moment).shape == (2, problem.observations)


@pytest.mark.parametrize("task", SUITE)
def test_an_episodes_count_is_one_graph_for_a_compiler(task: str) -> None:
    """An environment on the device is compiled whole, or not at all."""
    problem = SuiteProblem(task, steps=4)
    starts = problem.draw([1, 2])
    names = ("qpos", "qvel", "command", "ctrl")
    given = [torch.as_tensor(getattr(starts, name)).float() for name in names]
    score = problem.begin(*given[:3])
    # traced as it would be, and run as it is: no kernel is made
    traced = torch.compile(problem.count, fullgraph=True, dynamic=False, backend="eager")
    found = traced(score, given[0], given[1], given[3])
    torch.testing.assert_close(found, problem.count(score, given[0], given[1], given[3]))
