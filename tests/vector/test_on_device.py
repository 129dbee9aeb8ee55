"""Worlds that never leave the device between two steps."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
import torch

import orbisim
from orbisim.errors import CapacityError, InputError
from tests.vector import own
from tests.vector.placed import Place, PlacedBackend

COUNT = 4


class Plain(own.Reach):
    """As `Reach`, with one model for all worlds: branches, two kinds of ends, a drawn number."""

    def initialize_episode(self, physics: Any) -> None:
        physics.named.data.qpos["x"] = self.random.uniform(-0.2, 0.2)
        self.far = self.random.uniform(0.6, 1.2)

    def get_termination(self, physics: Any) -> Any:
        position = physics.named.data.qpos["x"][0]
        if position < -0.3:
            return 0.0
        return 0.5 if position > 0.3 else None


class Doubtful(Plain):
    """Reads a number of the physics on the host, where its time is up."""

    def get_reward(self, physics: Any) -> Any:
        reward = super().get_reward(physics)
        return reward * (float(physics.named.data.qpos["x"][0]) if self.asks else 1.0)

    asks = False


def environments(task: type[own.Reach] = Plain, **options: Any) -> tuple[Any, Any, PlacedBackend]:
    """One on a device, and C MuJoCo's own."""
    make, backend = own.environment(task, **options), PlacedBackend()
    load = orbisim.vector.from_environment
    there = load(make, COUNT, backend, seed=0, arrays="torch")
    return there, load(make, COUNT, seed=0), backend


def equal(there: Any, here: Any) -> None:
    for name, rows in here.observation.items():
        assert torch.is_tensor(there.observation[name])
        np.testing.assert_allclose(there.observation[name].numpy(), rows, rtol=0, atol=1e-12)
    np.testing.assert_allclose(there.reward.numpy(), here.reward, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(there.terminated.numpy(), here.terminated)
    np.testing.assert_array_equal(there.truncated.numpy(), here.truncated)


def actions(nu: int = 1, seed: int = 0) -> Any:
    random = np.random.default_rng(seed)
    return (random.uniform(0.2, 1, (COUNT, nu)) * [[-1], [1], [-1], [0.1]] for _ in iter(int, 1))


@pytest.mark.parametrize("flat", [False, True])
def test_steps_are_those_of_the_host(flat: bool) -> None:
    there, here, _ = environments(time_limit=1.6, flat_observation=flat)
    assert there.evaluation == "on the device", there.reason
    first, expected = there.reset(), here.reset()
    for name, rows in expected.items():
        np.testing.assert_array_equal(first[name].numpy(), rows)
    ends = np.zeros((3, COUNT), int)  # by termination, by anything else, by time
    for action in itertools.islice(actions(), 300):
        step, other = there.step(torch.as_tensor(action)), here.step(action)
        equal(step, other)
        late = here._count >= 80
        ends += [other.terminated, other.truncated & ~late, late]
        np.testing.assert_allclose(there.state.qpos, here.state.qpos, rtol=0, atol=1e-12)
        np.testing.assert_allclose(there.state.time, here.state.time, rtol=0, atol=1e-12)
    assert (ends.sum(axis=1) > 0).all(), "discounts of 0 and of 0.5, and time limits"


@pytest.mark.parametrize(
    ("domain", "task"), [("hopper", "hop"), ("quadruped", "run"), ("humanoid", "walk")]
)
def test_tasks_of_the_suite(domain: str, task: str) -> None:
    load, options = orbisim.vector.load, {"seed": 0, "task_kwargs": {"time_limit": 0.1}}
    there = load(domain, task, 2, PlacedBackend(), arrays="torch", **options)
    here = load(domain, task, 2, **options)
    assert there.evaluation == "on the device", there.reason
    there.reset(), here.reset()
    random = np.random.default_rng(0)
    for _ in range(8):
        action = random.uniform(-1, 1, (2, here.action_spec().shape[0]))
        step, other = there.step(action), here.step(action)
        np.testing.assert_allclose(step.reward.numpy(), other.reward, rtol=0, atol=1e-9)


def test_a_field_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Place, "names", Place.names - {"xipos"})
    there = orbisim.vector.load("hopper", "hop", 2, PlacedBackend(), arrays="torch", seed=0)
    assert there.evaluation == "batched"
    assert "physics.data.xipos on the device" in there.reason


def test_some_worlds_begin_anew() -> None:
    there, here, _ = environments(time_limit=5.0)
    with pytest.raises(InputError, match="after a reset"):
        there.restart([0])
    there.reset(7), here.reset(7)
    some = list(itertools.islice(actions(), 6))
    for action in some[:3]:
        equal(there.step(action), here.step(action))
    mask = torch.tensor([False, True, False, True])
    found, expected = there.restart(mask), here.restart(mask.numpy())
    for name, rows in expected.items():
        np.testing.assert_allclose(found[name].numpy(), rows, rtol=0, atol=1e-12)
    for action in some[3:]:
        equal(there.step(action), here.step(action))


def test_the_first_step_resets() -> None:
    there, here, _ = environments()
    for action in itertools.islice(actions(), 3):
        equal(there.step(action), here.step(action))


def test_torchrl_resets_by_a_mask() -> None:
    there, _, _ = environments()
    tensors = orbisim.vector.TensorEnvironment(there)
    tensors.reset()
    done = torch.tensor([[True], [False], [False], [True]])
    assert tensors.reset({"_reset": done})["done"].shape == (COUNT, 1)


def test_worlds_that_diverge() -> None:
    there, here, _ = environments(time_limit=5.0)
    there.reset(), here.reset()
    bad = np.array([[0.5], [np.nan], [0.5], [0.5]])
    before = there.step(np.zeros((COUNT, 1)))
    here.step(np.zeros((COUNT, 1)))
    step, other = there.step(torch.as_tensor(bad)), here.step(bad)
    assert other.truncated.tolist() == [False, True, False, False]
    equal(step, other)
    assert step.observation["to_target"][1].tolist() == before.observation["to_target"][1].tolist()
    assert there.diverged.tolist() == [0, 1, 0, 0]
    for action in itertools.islice(actions(), 3):
        equal(there.step(action), here.step(action))


def test_what_is_returned_stays() -> None:
    there, _, _ = environments(time_limit=5.0)
    first = there.reset()["speed"]
    kept = first.clone()
    step = there.step(np.ones((COUNT, 1)))
    reward = step.reward.clone()
    step.observation["speed"].fill_(9.0)
    there.step(np.ones((COUNT, 1)))
    assert torch.equal(first, kept)
    assert torch.equal(step.reward, reward)
    assert not (there.step(np.ones((COUNT, 1))).observation["speed"] == 9.0).any()


def test_a_step_that_does_not_fit_is_repeated() -> None:
    there, here, backend = environments(time_limit=5.0)
    there.reset(), here.reset()
    place = next(place for place in backend.places if not place.closed)
    for k, action in enumerate(itertools.islice(actions(), 6)):
        place.too_small = 2 * (k % 2)
        equal(there.step(action), here.step(action))
    assert place.generation == 7
    place.too_small = 100
    with pytest.raises(CapacityError, match="do not fit after 6 enlargements"):
        there.step(np.zeros((COUNT, 1)))


def test_models_that_differ_stay_on_the_host() -> None:
    load, options = orbisim.vector.load, {"seed": 0, "task_kwargs": {"time_limit": 0.1}}
    there = load("reacher", "easy", COUNT, PlacedBackend(), arrays="torch", **options)
    here = load("reacher", "easy", COUNT, **options)
    assert there.evaluation == "batched"
    assert "models that differ from world to world ('geom_pos')" in there.reason
    there.reset(), here.reset()
    for action in itertools.islice(actions(2), 8):
        step, other = there.step(torch.as_tensor(action)), here.step(action)
        np.testing.assert_allclose(step.reward.numpy(), other.reward, rtol=0, atol=1e-9)


@pytest.mark.parametrize("begins", [False, True])
def test_functions_that_fail_later_go_on_on_the_host(begins: bool) -> None:
    there, here, backend = environments(Doubtful, time_limit=0.2)
    assert there.evaluation == "on the device", there.reason
    there.reset(), here.reset()
    asked = 13 if begins else 4  # in a step in which one world begins, and before
    for k, action in enumerate(itertools.islice(actions(), 30)):
        if k == 3:
            there.restart([1]), here.restart([1])
        if k == asked:
            for environment in (there, here):
                for task in environment._tasks.each:
                    task.asks = True
                for world in range(COUNT):
                    environment._tasks.note(world)
        equal(there.step(torch.as_tensor(action)), here.step(action))
        assert (there.evaluation == "on the device") == (k < asked)
    assert "float() or int() of a value on the device" in there.reason
    assert all(place.closed for place in backend.places)


def test_functions_that_differ_are_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    from orbisim.vector import tensor_worlds

    monkeypatch.setitem(tensor_worlds._UFUNCS, np.subtract, lambda a, b: (a - b) * (1 + 1e-9))
    there, _, _ = environments()
    assert there.evaluation == "batched"
    assert there.reason.startswith("to_target differs by up to")


def test_shapes_of_actions_are_checked() -> None:
    there, _, _ = environments()
    there.reset()
    with pytest.raises(InputError, match=r"action has shape \(3, 1\)"):
        there.step(torch.zeros(3, 1))


def test_environments_are_closed() -> None:
    there, _, backend = environments()
    there.close()
    assert all(place.closed for place in backend.places)


READS = ("numpy", "cpu", "item", "tolist", "__array__", "__bool__", "__float__", "__int__")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("domain", "task"), [("cartpole", "swingup"), ("cheetah", "run"), ("hopper", "hop")]
)
def test_a_step_reads_three_flags(domain: str, task: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco_warp")
    load, options = orbisim.vector.load, {"seed": 0, "task_kwargs": {"time_limit": 0.2}}
    there = load(domain, task, 3, "warp", "cpu", arrays="torch", **options)
    here = load(domain, task, 3, "warp", "cpu", **options)
    assert there.evaluation == "on the device", there.reason
    there.reset(), here.reset()
    nu = here.action_spec().shape[0]
    random, counted = np.random.default_rng(0), []
    moved = {name: getattr(torch.Tensor, name) for name in READS}
    made = {name: getattr(torch, name) for name in ("tensor", "from_numpy")}

    def counting(name: str, function: Any) -> Any:
        def call(*args: Any, **kwargs: Any) -> Any:
            counted.append(name)
            return function(*args, **kwargs)

        return call

    for k in range(45):
        action = torch.from_numpy(random.uniform(-1, 1, (3, nu)))
        count = int(there._count[0])
        with monkeypatch.context() as patched:
            for name, function in moved.items():
                patched.setattr(torch.Tensor, name, counting(name, function))
            for name, function in made.items():
                patched.setattr(torch, name, counting(name, function))
            counted.clear()
            step = there.step(action)
            found = list(counted)
        if k > 1 and 0 < count < there._limit - 1 and not there._over.any():
            assert found == ["tolist"], "all three flags at once"
        other = here.step(action.numpy())
        np.testing.assert_array_equal(step.truncated.numpy(), other.truncated)
        np.testing.assert_allclose(step.reward.numpy(), other.reward, rtol=0, atol=1e-6)
        for name, rows in other.observation.items():
            np.testing.assert_allclose(step.observation[name].numpy(), rows, rtol=0, atol=1e-6)
