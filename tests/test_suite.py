"""dm_control's suite through OrbiSim equals dm_control's own, bit for bit."""

from __future__ import annotations

import copy
import pickle

import dm_env
import numpy as np
import pytest
from dm_control import suite as dm_suite
from dm_control.rl import control
from dm_control.suite import cartpole
from dm_control.suite.wrappers import action_scale, pixels

import orbisim
from orbisim import suite
from orbisim.errors import InputError, UnknownNameError

STEPS = 40


def test_nothing_is_said_about_the_suites_own_files(capfd: pytest.CaptureFixture[str]) -> None:
    suite.load("cheetah", "run")  # declares an attribute that MuJoCo is about to drop
    orbisim.vector.load("cheetah", "run", nworld=2)
    assert capfd.readouterr() == ("", "")


def same_steps(ours: dm_env.TimeStep, theirs: dm_env.TimeStep) -> None:
    assert ours.step_type == theirs.step_type
    assert ours.reward == theirs.reward
    assert ours.discount == theirs.discount
    assert ours.observation.keys() == theirs.observation.keys()
    for name, value in theirs.observation.items():
        np.testing.assert_array_equal(ours.observation[name], value, err_msg=name)


@pytest.mark.parametrize(("domain", "task"), suite.ALL_TASKS, ids=lambda name: name)
def test_equals_dm_control(domain: str, task: str) -> None:
    try:
        theirs = dm_suite.load(domain, task, task_kwargs={"random": 7})
    except RuntimeError as error:  # quadruped-escape needs OpenGL to place its camera
        pytest.skip(f"dm_control itself fails here: {error}")
    ours = suite.load(domain, task, task_kwargs={"random": 7})
    assert isinstance(ours, control.Environment)
    same_steps(ours.reset(), theirs.reset())
    spec = theirs.action_spec()
    rng = np.random.default_rng(0)
    low, high = np.maximum(spec.minimum, -1), np.minimum(spec.maximum, 1)
    for _ in range(STEPS):
        action = rng.uniform(low, high, spec.shape)
        same_steps(ours.step(action), theirs.step(action))


def test_every_task_is_listed() -> None:
    assert len(suite.ALL_TASKS) == 51
    assert set(suite.BENCHMARKING) < set(suite.ALL_TASKS)


@pytest.mark.parametrize(
    ("domain", "task", "message"),
    [("cheeta", "run", "did you mean 'cheetah'"), ("cheetah", "walk", "known: run")],
)
def test_unknown_tasks(domain: str, task: str, message: str) -> None:
    with pytest.raises(UnknownNameError, match=message):
        suite.load(domain, task)


def test_environment_arguments_are_passed_on() -> None:
    environment = suite.load(
        "cartpole", "swingup", {"random": 0}, {"flat_observation": True}, visualize_reward=True
    )
    assert environment.reset().observation["observations"].shape == (5,)


def test_physics_is_of_the_tasks_own_class() -> None:
    environment = suite.load("cartpole", "balance")
    assert isinstance(environment.physics, cartpole.Physics)
    assert environment.physics.cart_position() == 0 or True
    assert environment.physics.backend == "mujoco"


def test_switching_in_the_middle_of_an_episode_changes_nothing() -> None:
    plain = suite.load("walker", "walk", {"random": 1})
    switched = suite.load("walker", "walk", {"random": 1})
    plain.reset(), switched.reset()
    rng = np.random.default_rng(0)
    for t in range(20):
        action = rng.uniform(-1, 1, 6)
        a, b = plain.step(action), switched.step(action)
        same_steps(b, a)
        if t == 10:
            switched.physics.use_renderer("null")
            switched.physics.use_backend("mujoco")


def test_dm_control_wrappers_work() -> None:
    environment = suite.load("reacher", "easy", {"random": 0}, renderer="null")
    scaled = action_scale.Wrapper(environment, minimum=-2.0, maximum=2.0)
    seen = pixels.Wrapper(scaled, render_kwargs={"height": 16, "width": 24})
    assert seen.reset().observation["pixels"].shape == (16, 24, 3)
    assert not seen.step(np.ones(2)).last()


def test_gymnasium_through_shimmy() -> None:
    pytest.importorskip("gymnasium")
    shimmy = pytest.importorskip("shimmy")
    environment = shimmy.DmControlCompatibilityV0(suite.load("cartpole", "swingup", {"random": 0}))
    observation, _ = environment.reset(seed=0)
    assert set(observation) == {"position", "velocity"}
    observation, reward, terminated, _, _ = environment.step(environment.action_space.sample())
    assert np.isfinite(reward)
    assert not terminated


class Upright(orbisim.Physics):
    """A user's own physics."""

    def height(self) -> float:
        return float(self.named.data.xpos["pole", "z"])


class Balance(control.Task):
    """A user's own task, without composer."""

    def initialize_episode(self, physics: Upright) -> None:
        physics.named.data.qpos["hinge"] = 0.1

    def before_step(self, action: np.ndarray, physics: Upright) -> None:
        physics.set_control(action)

    def action_spec(self, physics: Upright) -> dm_env.specs.BoundedArray:
        return dm_env.specs.BoundedArray((1,), float, -1, 1)

    def get_observation(self, physics: Upright) -> dict[str, np.ndarray]:
        return {"height": np.array([physics.height()])}

    def get_reward(self, physics: Upright) -> float:
        return physics.height()


OWN = """
<mujoco>
  <worldbody>
    <body name="cart"><joint name="slide" type="slide" axis="1 0 0"/><geom size="0.1"/>
      <body name="pole" pos="0 0 0.5"><joint name="hinge" pos="0 0 -0.5" axis="0 1 0"/>
        <geom size="0.05"/></body>
    </body>
  </worldbody>
  <actuator><motor joint="slide"/></actuator>
</mujoco>
"""


@pytest.mark.parametrize("backend", ["mujoco", "warp"])
def test_a_users_own_task(backend: str) -> None:
    if backend == "warp":
        pytest.importorskip("mujoco_warp")
    physics = Upright.from_xml_string(OWN, backend=backend)
    environment = control.Environment(physics, Balance(), time_limit=0.1)
    first = environment.reset()
    assert first.observation["height"][0] == pytest.approx(0.5 * np.cos(0.1), abs=1e-6)
    rewards = []
    while not (step := environment.step(np.zeros(1))).last():
        rewards.append(step.reward)
    assert rewards[-1] < rewards[0]  # it falls


def test_tasks_can_be_copied_and_pickled() -> None:
    environment = suite.load("cartpole", "swingup", {"random": 0})
    environment.reset()
    physics = environment.physics
    for twin in (physics.copy(), pickle.loads(pickle.dumps(physics)), copy.deepcopy(physics)):
        assert isinstance(twin, cartpole.Physics)
        np.testing.assert_array_equal(twin.get_state(), physics.get_state())
        twin.step()
        assert twin.time() > physics.time()


def test_a_state_is_one_world() -> None:
    physics = suite.load("cartpole", "swingup").physics
    with pytest.raises(InputError, match="one world"):
        physics.restore(physics.snapshot().tile(2))
