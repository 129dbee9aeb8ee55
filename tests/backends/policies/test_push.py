from __future__ import annotations

import copy

import mujoco
import numpy as np
import pytest
import torch
from orbisim_policies.push import BORDER, REACH, PushProblem

from orbisim.tasks.push import SUCCESS_DISTANCE
from orbisim.tasks.tabletop import build


def test_a_written_model_is_the_one_that_the_task_builds(push: PushProblem) -> None:
    scene, starts = push.trials(1, 7)
    model = copy.copy(push.model)
    push.write(model, starts.params[0])
    built = build("push", push.layout(7).setting, "push", starts.qpos[0], starts.ctrl[0]).model
    for name in dir(built):
        value = getattr(built, name)
        if isinstance(value, np.ndarray) and name.startswith(("geom_", "body_", "dof_")):
            if name == "geom_rgba":
                continue
            np.testing.assert_allclose(getattr(model, name), value, atol=1e-10, err_msg=name)
    assert scene.model.nq == built.nq


def test_episodes_are_of_their_seeds(push: PushProblem) -> None:
    starts, again = push.draw([3, 4]), push.draw([4])
    np.testing.assert_array_equal(starts.params[1], again.params[0])
    np.testing.assert_allclose(starts.qpos[1], again.qpos[0], atol=1e-6)
    data = mujoco.MjData(push.scene.model)
    data.qpos[:] = starts.qpos[0]
    mujoco.mj_forward(push.scene.model, data)
    np.testing.assert_allclose(data.site("tcp").xpos, starts.command[0, :3], atol=1e-4)


def test_rewards_are_the_papers(push: PushProblem) -> None:
    qpos = torch.tensor(push.draw([1]).qpos).float()
    score = push.begin(qpos, torch.zeros(1, 20), torch.zeros(1, 10))
    assert torch.equal(push.value(score, qpos), torch.zeros(1, 3))
    moved = qpos.clone()
    moved[:, 15] += 0.3 * (BORDER - qpos[:, 15])  # cube 2 goes 30 % of its way to the edge
    _, first, second = push._where(moved)
    score = push.count(score, moved, torch.zeros(1, 20), torch.zeros(1, 7))
    r1, r2, r3 = push.value(score, moved)[0].tolist()
    assert r1 == 0.0  # the hand is where it was
    assert r3 == pytest.approx(0.3, abs=1e-5)
    assert r2 <= max(0.0, 1 - float((first - second).norm()) / float(score[0, 3])) + 1e-4


def test_smallest_distances_are_kept(push: PushProblem) -> None:
    qpos = torch.tensor(push.draw([1]).qpos).float()
    score, near = push.begin(qpos, torch.zeros(1, 20), torch.zeros(1, 10)), qpos.clone()
    near[:, 8:11] = push._where(qpos)[0] + 0.02  # cube 1 comes to the hand and goes again
    for state in (near, qpos):
        score = push.count(score, state, torch.zeros(1, 20), torch.zeros(1, 7))
    assert push.value(score, qpos)[0, 0] > 0.5


def test_actions_move_the_commanded_pose_and_have_gradients(push: PushProblem) -> None:
    command = torch.tensor(push.draw([2]).command).float()
    action = torch.tensor([[0.5, -0.3, 0.2, 0.4]], requires_grad=True)
    control, after = push.control(command, action)
    np.testing.assert_allclose(
        (after - command)[0, :3].detach(), REACH * np.array([0.5, -0.3, 0.2]), atol=1e-6
    )
    assert torch.allclose(push.arm.pose(control[:, :6])[0], after[:, :3], atol=2e-4)
    (gradient,) = torch.autograd.grad(control[0, 1], action)
    for k in range(4):  # against finite differences of the controller that iterates
        step = torch.zeros(1, 4)
        step[0, k] = 0.05
        high, low = (push.control(command, (action + s * step).detach())[0] for s in (1, -1))
        assert float((high - low)[0, 1]) / 0.1 == pytest.approx(float(gradient[0, k]), abs=2e-3)


def test_success_by_each_definition(push: PushProblem) -> None:
    starts = push.draw([5, 5, 5, 5])
    end = starts.qpos.copy()
    end[1, 15] += SUCCESS_DISTANCE + 0.01  # moved
    end[2, 15], end[2, 8:11] = 0.9, (0.6, 0.6, -0.7)  # far, but cube 1 fell
    end[3, 15:18] = (1.0, 0.0, -0.7)  # over the far edge
    found = push.success(starts, end, np.zeros((4, 3)))
    assert found["moved"].tolist() == [False, True, True, True]
    assert found["on_table"].tolist() == [False, True, False, False]
    assert found["region"].tolist() == [False, False, False, True]
