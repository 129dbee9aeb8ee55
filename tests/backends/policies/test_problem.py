from __future__ import annotations

import numpy as np
import torch
from orbisim_policies.problem import Moment, Problem
from orbisim_policies.push import PushProblem
from orbisim_policies.suite import SuiteProblem


def test_problems_have_the_sizes_that_they_say(push: PushProblem, cartpole: SuiteProblem) -> None:
    problems: list[Problem] = [push, cartpole]
    for problem in problems:
        starts = problem.draw([1, 2])
        fields = (starts.qpos, starts.qvel, starts.command, starts.params)
        qpos, qvel, command, params = (torch.as_tensor(f).float() for f in fields)
        score = problem.begin(qpos, qvel, command)
        view = problem.observe(Moment(qpos, qvel, command, params, score, torch.zeros(2)))
        assert view.shape == (2, problem.observations)
        control, after = problem.control(command, torch.zeros(2, problem.actions))
        assert control.shape == (2, problem.scene.model.nu) and after.shape == command.shape
        score = problem.count(score, qpos, qvel, control)
        assert problem.value(score, qpos).shape == (2, len(problem.parts))
        assert problem.measure(score, qpos).shape == (2, len(problem.parts))
        np.testing.assert_array_equal(starts.at(slice(1, 2)).qpos, starts.qpos[1:])
        scene, trials = problem.trials(2, 1)
        assert len(trials) == 2 and scene.model.nq == problem.scene.model.nq
