"""Many worlds give what dm_control gives in each, to the bit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from dm_control import suite
from dm_control.rl import control

import orbisim
from orbisim.errors import InputError
from orbisim.vector import VectorEnvironment
from tests.vector import own

NWORLD = 4

TASKS = [
    ("cartpole", "swingup"),
    ("ball_in_cup", "catch"),  # a flag of each world
    ("finger", "turn_hard"),  # targets of each world
    ("lqr", "lqr_2_1"),  # springs of each world
]


def equal_steps(
    ours: VectorEnvironment, theirs: list[control.Environment], steps: int, seed: int = 0
) -> int:
    """Compares everything; returns how many episodes ended."""
    spec = ours.action_spec()
    low, high = np.maximum(spec.minimum, -1.0), np.minimum(spec.maximum, 1.0)
    random = np.random.default_rng(seed)
    observation, ended = ours.reset(), 0
    for world, one in enumerate(theirs):
        for name, value in one.reset().observation.items():
            np.testing.assert_array_equal(observation[name][world], value, err_msg=name)
    for _ in range(steps):
        action = random.uniform(low, high, (ours.nworld, *spec.shape))
        step = ours.step(action)
        for world, one in enumerate(theirs):
            result = one.step(action[world])
            assert list(step.observation) == list(result.observation)
            for name, value in result.observation.items():
                np.testing.assert_array_equal(step.observation[name][world], value, err_msg=name)
            assert step.reward[world] == (result.reward or 0.0)
            assert step.terminated[world] == (result.last() and result.discount == 0.0)
            assert step.truncated[world] == (result.last() and result.discount != 0.0)
            ended += result.last()
    return ended


@pytest.mark.parametrize(("domain", "task"), TASKS, ids=lambda name: name)
def test_equals_dm_control(domain: str, task: str) -> None:
    kwargs = {"time_limit": 0.3}
    ours = orbisim.vector.load(domain, task, NWORLD, seed=7, task_kwargs=kwargs)
    theirs = [
        suite.load(domain, task, task_kwargs={"random": 7 + world, **kwargs})
        for world in range(NWORLD)
    ]
    assert ours.evaluation == "batched", ours.reason
    assert equal_steps(ours, theirs, 35) >= NWORLD


@pytest.mark.slow
@pytest.mark.parametrize(("domain", "task"), orbisim.suite.ALL_TASKS, ids=lambda name: name)
def test_every_task_equals_dm_control(domain: str, task: str) -> None:
    kwargs = {"time_limit": 1.0}
    try:
        theirs = [
            suite.load(domain, task, task_kwargs={"random": world, **kwargs}) for world in range(2)
        ]
    except RuntimeError as error:  # quadruped-escape needs OpenGL to place its camera
        pytest.skip(f"dm_control itself fails here: {error}")
    ours = orbisim.vector.load(domain, task, 2, seed=0, task_kwargs=kwargs)
    assert ours.evaluation == "batched", ours.reason
    assert equal_steps(ours, theirs, 110) >= 2


KINDS = {
    own.Reach: "batched",
    own.Fixed: "batched",
    own.Counting: "world by world",
    own.Drawing: "world by world",
    own.Wind: "world by world",
}


@pytest.mark.parametrize("kind", KINDS)
def test_tasks_of_users(kind: type[own.Reach]) -> None:
    make = own.environment(kind)
    ours = orbisim.vector.from_environment(make, NWORLD, seed=3)
    assert ours.evaluation == KINDS[kind], ours.reason
    assert equal_steps(ours, [make(3 + world) for world in range(NWORLD)], 90) > NWORLD


def test_flat_observations() -> None:
    make = own.environment(flat_observation=True)
    ours = orbisim.vector.from_environment(make, 2, seed=0)
    assert equal_steps(ours, [make(0), make(1)], 30)
    assert ours.observation_spec()["observations"].shape == (5,)


def test_seeds() -> None:
    environment = orbisim.vector.load("pendulum", "swingup", 3, seed=5)
    first = environment.reset()["orientation"]
    assert not np.array_equal(environment.reset()["orientation"], first)
    np.testing.assert_array_equal(environment.reset(seed=5)["orientation"], first)
    np.testing.assert_array_equal(environment.reset(seed=[6, 7, 5])["orientation"][2], first[0])
    again = environment.reset(seed=[5, None, None])["orientation"]
    np.testing.assert_array_equal(again[0], first[0])
    with pytest.raises(InputError, match="2 seeds for 3 worlds"):
        environment.reset(seed=[0, 1])


def test_the_threads_make_no_difference() -> None:
    runs = []
    for nthread in (1, 3):
        environment = orbisim.vector.load("hopper", "hop", 4, seed=0, nthread=nthread)
        environment.reset()
        for _ in range(10):
            step = environment.step(np.full((4, 4), 0.3))
        runs.append((step.reward, environment.state.qpos))
    np.testing.assert_array_equal(runs[0][0], runs[1][0])
    np.testing.assert_array_equal(runs[0][1], runs[1][1])


def test_the_first_step_begins_an_episode() -> None:
    environment = orbisim.vector.load("cartpole", "balance", 2, seed=0)
    step = environment.step(np.ones((2, 1)))
    assert not step.reward.any() and not step.truncated.any()
    assert environment.state.time.tolist() == [0.0, 0.0]
    assert environment.control_timestep() == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros((3, 1)), r"action has shape \(3, 1\); cartpole-balance in 2 worlds needs"),
        (np.zeros(1), "needs"),
        ("left", "action"),
    ],
)
def test_actions_that_are_none(action: Any, message: str) -> None:
    environment = orbisim.vector.load("cartpole", "balance", 2, seed=0)
    environment.reset()
    with pytest.raises(InputError, match=message):
        environment.step(action)


def _huge(environment: VectorEnvironment) -> None:
    environment._simulator._batch.bind("qvel")[1] = 1e200


def _nan_action(environment: VectorEnvironment) -> None:
    environment._nan = True  # type: ignore[attr-defined]


@pytest.mark.parametrize("harm", [_huge, _nan_action], ids=["state", "action"])
def test_one_world_diverges(harm: Callable[[VectorEnvironment], None]) -> None:
    """It is reset and counted; the others go on as if nothing had happened."""
    environment = orbisim.vector.load("cartpole", "balance", 3, seed=0)
    alone = orbisim.vector.load("cartpole", "balance", 3, seed=0)
    action = np.full((3, 1), 0.1)
    environment.reset(), alone.reset()
    before = environment.step(action)
    alone.step(action)
    harm(environment)
    bad = action.copy()
    bad[1] = np.nan if harm is _nan_action else 0.1
    step, expected = environment.step(bad), alone.step(action)
    assert environment.diverged.tolist() == [0, 1, 0]
    assert step.truncated.tolist() == [False, True, False] and not step.terminated.any()
    assert step.reward[1] == 0.0
    np.testing.assert_array_equal(
        step.observation["position"][1], before.observation["position"][1]
    )
    np.testing.assert_array_equal(step.reward[[0, 2]], expected.reward[[0, 2]])
    step = environment.step(action)
    assert environment.state.time[1] == 0.0 and not step.truncated.any()
    assert np.isfinite(environment.step(action).reward).all()


def test_a_reward_that_is_no_number_in_one_world() -> None:
    """That world is reset and counted as one that diverges; the others go on."""
    xml = own.XML

    def reward(physics: Any) -> Any:
        return np.sqrt(0.5 - physics.named.data.qpos["x"][0])

    def begin(physics: Any, random: Any) -> None:
        physics.named.data.qpos["x"] = random.uniform(-0.2, 0.2)

    environment = orbisim.vector.from_scene(xml, 3, reward=reward, initialize=begin, seed=0)
    environment.reset()
    environment._simulator._batch.bind("qpos")[1, 0] = 0.7
    step = environment.step(np.zeros((3, 1)))
    assert environment.diverged.tolist() == [0, 1, 0]
    assert step.truncated.tolist() == [False, True, False] and not step.terminated.any()
    assert step.reward[1] == 0.0 and (step.reward[[0, 2]] > 0.0).all()
    step = environment.step(np.zeros((3, 1)))
    assert environment.state.time[1] == 0.0 and environment.state.time[0] > 0.0
    assert environment.diverged.sum() == 1 and not step.truncated.any()


def test_restart_of_some_worlds() -> None:
    environment = orbisim.vector.load("cartpole", "balance", 3, seed=0)
    with pytest.raises(InputError, match="after a reset of all"):
        environment.restart([0])
    environment.reset()
    last = environment.step(np.zeros((3, 1))).observation
    for worlds in ([1], np.array([False, True, False])):
        observation = environment.restart(worlds)
        assert environment.state.time.tolist() == [0.01, 0.0, 0.01]
        np.testing.assert_array_equal(observation["velocity"][[0, 2]], last["velocity"][[0, 2]])
    for wrong in ([3], [-1], 0, [0.5]):
        with pytest.raises(InputError, match="worlds are numbers from 0 to 2"):
            environment.restart(wrong)


def test_tensors() -> None:
    torch = pytest.importorskip("torch")
    environment = orbisim.vector.load("cheetah", "run", 2, seed=0, arrays="torch")
    arrays = orbisim.vector.load("cheetah", "run", 2, seed=0)
    assert torch.equal(
        environment.reset()["position"], torch.from_numpy(arrays.reset()["position"])
    )
    action = torch.full((2, 6), 0.2, dtype=torch.float64)
    step, expected = environment.step(action), arrays.step(action.numpy())
    assert torch.equal(step.reward, torch.from_numpy(expected.reward))
    assert step.terminated.dtype == torch.bool
    with pytest.raises(InputError, match="'numpy' or 'torch'"):
        orbisim.vector.load("cheetah", "run", 2, arrays="jax")  # type: ignore[arg-type]


class Settling(own.Reach):
    """Lets the ball fall before an episode begins; of some episodes, in another model."""

    varies = False

    def initialize_episode(self, physics: Any) -> None:
        physics.named.data.qpos["x"] = self.random.uniform(-0.2, 0.2)
        self.far = self.random.uniform(1.0, 2.0)
        physics.step(nstep=20)
        physics.data.time = 0
        if self.varies and self.random.uniform() < 0.5:
            physics.named.model.site_pos["target", "x"] = self.random.uniform(-1, 1)


class SettlingElsewhere(Settling):
    """With a target that moves."""

    varies = True


@pytest.mark.parametrize("task", [Settling, SettlingElsewhere])
def test_episodes_that_begin_side_by_side(task: type[own.Reach]) -> None:
    load, make = orbisim.vector.from_environment, own.environment(task, time_limit=0.1)
    several, one = (load(make, 12, seed=0, nthread=n) for n in (3, 1))
    for k in range(14):
        action = np.full((12, 1), 0.5 if k % 2 else -0.5)
        step, expected = several.step(action), one.step(action)
        np.testing.assert_array_equal(step.reward, expected.reward)
        for name, rows in expected.observation.items():
            np.testing.assert_array_equal(step.observation[name], rows)
    assert len(several._starters) == 3 and not one._starters
    assert set(several._fields.varied) == ({"site_pos"} if task.varies else set())
    assert several.reset()["to_target"].tolist() == one.reset()["to_target"].tolist()
