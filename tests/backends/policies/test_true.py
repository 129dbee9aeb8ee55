from __future__ import annotations

import mujoco
import numpy as np
import torch
from orbisim_policies.push import PushProblem
from orbisim_policies.suite import SuiteProblem
from orbisim_policies.true import TrueWorlds

from orbisim import State, make_backend
from orbisim.effects.base import EffectInstance
from orbisim.effects.carry import add_effects
from orbisim.tasks.tabletop import build


def test_it_is_mujoco_in_the_scene_of_each_world(push: PushProblem) -> None:
    starts = push.draw([1, 2])
    worlds = TrueWorlds(push, 2, nthread=1)
    worlds.begin(np.arange(2), starts)
    action = torch.tensor([[0.6, -0.2, -1.0, 0.1]] * 2)
    command = torch.as_tensor(starts.command).float()
    for _ in range(push.steps):
        worlds.step(action)
    for world, seed in enumerate((1, 2)):
        setting = push.layout(seed).setting
        model = build("push", setting, "push", starts.qpos[world], starts.ctrl[world]).model
        data = mujoco.MjData(model)
        data.qpos[:] = starts.qpos[world]
        kept = command[world : world + 1]
        for _ in range(push.steps):
            control, kept = push.control(kept, action[:1])
            data.ctrl[:] = control[0]
            mujoco.mj_step(model, data, 25)
        np.testing.assert_allclose(worlds.coordinates[0][world], data.qpos, atol=1e-6)
    assert worlds.over.all() and worlds.steps == 2 * push.steps
    worlds.close()


def test_a_world_that_diverges_is_counted_and_the_others_go_on(cartpole: SuiteProblem) -> None:
    worlds, starts = TrueWorlds(cartpole, 3, nthread=1), cartpole.draw([1, 2, 3])
    starts.qvel[1] = 1e9
    worlds.begin(np.arange(3), starts)
    lost = np.zeros(3, bool)
    for _ in range(4):
        lost |= worlds.step(torch.zeros(3, 1), np.flatnonzero(~lost))
    assert lost.tolist() == [False, True, False] and worlds.diverged.tolist() == [0, 1, 0]
    assert np.isfinite(worlds.coordinates[0][[0, 2]]).all()
    assert worlds.step(torch.tensor([[0.0], [0.0], [float("nan")]])).tolist()[2]
    worlds.begin(np.array([1, 2]), cartpole.draw([5, 6]))
    assert not worlds.step(torch.zeros(3, 1)).any()
    worlds.close()


def test_effects_that_a_scene_carries_are_applied() -> None:
    """Not native in MJCF: plain MuJoCo would leave them out and say nothing."""
    problem = SuiteProblem("cartpole-swingup", steps=8)
    values = {"coulomb": 3.0, "static": 4.0, "velocity": 0.05}
    drag = EffectInstance("stribeck_friction", "slider", values)
    problem.scene = add_effects(problem.scene, [drag])
    starts = problem.draw([1, 2])
    worlds = TrueWorlds(problem, 2, nthread=1)
    worlds.begin(np.arange(2), starts)
    for _ in range(problem.steps):
        worlds.step(torch.ones(2, 1))
    engine = make_backend("mujoco", problem.scene, nworld=2)
    state = State(np.zeros(2), starts.qpos, starts.qvel, np.zeros((2, 0)))
    expected = engine.step(state, np.ones((2, 1)), problem.steps)
    np.testing.assert_allclose(worlds.coordinates[0], expected.qpos, atol=1e-12)
    plain = make_backend("mujoco", SuiteProblem("cartpole-swingup").scene, nworld=2)
    other = plain.step(state, np.ones((2, 1)), problem.steps)
    assert np.abs(expected.qpos - other.qpos)[:, 0].min() > 1e-3
    worlds.close()


class Learned(SuiteProblem):
    """The cart-pole, stepped by what was learned of it."""

    backend = "learned"


def test_a_problem_may_name_what_steps_it() -> None:
    problem = Learned("cartpole-swingup", steps=8)
    starts = problem.draw([1, 2])
    worlds = TrueWorlds(problem, 2, nthread=1)
    worlds.begin(np.arange(2), starts)
    for _ in range(3):
        worlds.step(torch.ones(2, 1))
    engine = make_backend("learned", problem.scene, nworld=2)
    state = State(np.zeros(2), starts.qpos, starts.qvel, np.zeros((2, 0)))
    expected = np.asarray(engine.step(state, np.ones((2, 1)), 3).qpos)
    np.testing.assert_allclose(worlds.coordinates[0], expected, atol=1e-5)
    worlds.close()


def test_what_no_image_shows_can_be_nominal(push: PushProblem) -> None:
    starts = push.draw([3, 4])
    seen = []
    for nominal in (False, True):
        worlds = TrueWorlds(push, 2, 1, nominal)
        worlds.begin(np.arange(2), starts)
        seen.append(worlds.observation())
        worlds.step(torch.zeros((2, push.actions)))  # the scene itself is that of the episode
        seen.append(torch.as_tensor(worlds.coordinates[0]))
        worlds.close()
    differ = (seen[0] != seen[2]).any(0)
    assert 0 < int(differ.sum()) <= 3  # two densities, and the friction of the table
    assert (seen[2][:, differ] == 0).all()
    assert torch.equal(seen[1], seen[3])
