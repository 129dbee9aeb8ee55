from __future__ import annotations

import pytest
import torch
from orbisim_policies.environment import DeviceEnvironment
from orbisim_policies.learned import LearnedWorlds
from orbisim_policies.push import PushProblem
from orbisim_policies.rollout import advanced, began, observation, worth
from orbisim_policies.suite import SuiteProblem
from orbisim_world_model.watch import OutsideTrainingWarning

from orbisim.errors import InputError

WORLDS = 4


def _push(push: PushProblem, **changes: int) -> DeviceEnvironment:
    return DeviceEnvironment(push, WORLDS, device="cpu", starts=6, **changes)


def test_an_episode_is_that_of_the_learned_step(
    push: PushProblem, push_worlds: LearnedWorlds
) -> None:
    environment = _push(push, seed=3)
    view = environment.reset()["observations"]
    now = began(push_worlds, push_worlds.pool(push.draw(range(3, 3 + WORLDS))))
    torch.testing.assert_close(view, observation(push_worlds, now))
    torch.manual_seed(0)
    for t in range(push.steps):
        action = torch.rand(WORLDS, push.actions) * 2 - 1
        found = environment.step(action)
        with torch.no_grad():
            now = advanced(push_worlds, now, action, 0.0)
        seen = observation(push_worlds, now)
        torch.testing.assert_close(found.observation["observations"], seen, atol=1e-4, rtol=1e-3)
        last = t == push.steps - 1
        wanted = worth(push_worlds, now).sum(1) if last else torch.zeros(WORLDS)
        torch.testing.assert_close(found.reward, wanted, atol=1e-4, rtol=1e-3)
        assert found.terminated.all() == last and not found.truncated.any()


def test_the_step_after_the_last_begins_the_next_start(push: PushProblem) -> None:
    environment = _push(push)
    environment.reset()
    action = torch.ones(WORLDS, push.actions)
    for _ in range(push.steps):
        environment.step(action)
    found = environment.step(action)
    assert not found.terminated.any() and not found.reward.any()
    other = DeviceEnvironment(push, 6, device="cpu", starts=6).reset()["observations"]
    # of six starts, four worlds had the first four; they go on by four
    torch.testing.assert_close(found.observation["observations"], other[[4, 5, 0, 1]])
    again = environment.reset()["observations"]
    torch.testing.assert_close(again, other[:WORLDS])


def test_a_dense_reward_is_that_of_dm_control_and_ends_are_truncated(
    cartpole: SuiteProblem,
) -> None:
    environment = DeviceEnvironment(cartpole, WORLDS, device="cpu", starts=WORLDS)
    environment.reset()
    total = torch.zeros(WORLDS)
    for _ in range(cartpole.steps):
        found = environment.step(torch.ones(WORLDS, 1))
        total += found.reward
    assert found.truncated.all() and not found.terminated.any()
    assert ((total > 0) & (total < cartpole.steps)).all()


def test_a_world_that_diverges_is_truncated_and_begins_anew(push: PushProblem) -> None:
    environment = _push(push)
    before = environment.reset()["observations"]
    x = environment._state
    x[1][2] = 1e6  # the joint velocities of one world
    found = environment.step(torch.zeros(WORLDS, push.actions))
    assert found.truncated.tolist() == [False, False, True, False]
    assert environment.diverged.tolist() == [0, 0, 1, 0]
    torch.testing.assert_close(found.observation["observations"][2], before[2])
    after = environment.step(torch.zeros(WORLDS, push.actions))
    assert not after.truncated.any() and after.observation["observations"].isfinite().all()
    assert environment.diverged.sum() == 1


def test_what_left_the_training_data_is_said(push: PushProblem) -> None:
    environment = _push(push)
    environment.reset()
    cubes = environment._state[4]
    cubes[1, 0, 2] = 5.0  # high in the air
    with pytest.warns(OutsideTrainingWarning, match="'cube1' in 1"):
        for _ in range(push.steps):
            environment.step(torch.zeros(WORLDS, push.actions))


def test_actions_of_another_shape_are_refused(push: PushProblem) -> None:
    with pytest.raises(InputError, match="shape"):
        _push(push).step(torch.zeros(WORLDS, 1))
