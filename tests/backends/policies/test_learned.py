from __future__ import annotations

import numpy as np
import pytest
import torch
from orbisim_policies.learned import LearnedWorlds
from orbisim_policies.push import PushProblem
from orbisim_policies.rollout import advanced, began
from orbisim_policies.suite import SuiteProblem

from orbisim import State, make_backend
from orbisim.errors import InputError


def test_it_is_the_backends_step(push: PushProblem, push_worlds: LearnedWorlds) -> None:
    scene, starts = push.trials(2, 4)
    pool = push_worlds.pool(starts)
    x, context = push_worlds.begin(pool)
    control = torch.as_tensor(starts.ctrl).float()
    control[:, 0] += 0.1
    for _ in range(3):
        x = push_worlds.step(x, control, context)
    backend = make_backend("learned", scene, nworld=2, device="cpu")
    state = State(np.zeros(2), starts.qpos, starts.qvel, np.zeros((2, 0)))
    expected = backend.step(state, control.double().numpy(), 3)
    qpos, qvel = push_worlds.coordinates(x)
    np.testing.assert_allclose(qpos, expected.qpos, atol=2e-5)
    np.testing.assert_allclose(qvel, expected.qvel, atol=2e-4)


def test_dynamics_are_named_by_folder_or_in_the_zoo(push: PushProblem) -> None:
    cpu = torch.device("cpu")
    named = LearnedWorlds(push, "push_contacts", cpu)
    assert named.folder == LearnedWorlds(push, named.folder, cpu).folder
    assert named.folder != LearnedWorlds(push, None, cpu).folder
    with pytest.raises(InputError, match="no_such"):
        LearnedWorlds(push, "no_such", cpu)


def test_worlds_have_the_descriptors_of_their_own_scenes(
    push: PushProblem, push_worlds: LearnedWorlds
) -> None:
    starts = push.draw([1, 2])
    pool = push_worlds.pool(starts)
    column = push_worlds.layout.attributes.index("half_x")
    np.testing.assert_allclose(pool.attributes[:, :, column], starts.params[:, :2], rtol=1e-6)
    column = push_worlds.layout.settings.index("friction_slide")
    np.testing.assert_allclose(pool.settings[:, column], starts.params[:, 6], rtol=1e-6)


def test_a_box_at_rest_has_a_gradient(push: PushProblem, push_worlds: LearnedWorlds) -> None:
    pool = push_worlds.pool(push.draw([1]))
    x, context = push_worlds.begin(pool)
    control = torch.as_tensor(push.draw([1]).ctrl).float().requires_grad_()
    after = push_worlds.step(x, control, context)
    assert torch.equal(after.pos.detach(), x.pos)  # it does not move
    after.pos.sum().backward()
    assert control.grad is not None and control.grad.abs().sum() > 0


def test_another_control_step_is_refused(cartpole: SuiteProblem) -> None:
    other = SuiteProblem("cartpole-swingup", 4)
    other.timestep = 0.015
    with pytest.raises(InputError, match="multiple"):
        LearnedWorlds(other, None, torch.device("cpu"))


def test_one_model_of_many_robots_steps_as_its_backend_does(cartpole: SuiteProblem) -> None:
    """A model of limbs is conditioned on the scene's bodies, too."""
    worlds = LearnedWorlds(cartpole, "suite_one", torch.device("cpu"))
    worlds.model.eval()
    starts = cartpole.draw([1, 2])
    now = began(worlds, worlds.pool(starts))
    state = State(np.zeros(2), starts.qpos, starts.qvel, np.zeros((2, 0)))
    backend = make_backend(f"learned:{worlds.folder}", cartpole.scene, nworld=2, device="cpu")
    action = torch.tensor([[0.3], [-0.8]])
    for _ in range(3):
        now = advanced(worlds, now, action, 0.0)
        state = backend.step(state, action.numpy(), worlds.substeps)
    found = worlds.coordinates(now.x)[0].detach().numpy()
    np.testing.assert_allclose(found, np.asarray(state.qpos), atol=1e-5)
