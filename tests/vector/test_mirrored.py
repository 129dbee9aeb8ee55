"""Worlds that a backend steps."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from orbisim_mujoco import MujocoBackend

import orbisim
from orbisim.backend import Backend
from orbisim.errors import DivergedError, InputError, UnsupportedSceneError
from tests.vector import own


class Remembering(MujocoBackend):
    """C MuJoCo that counts its steps since a world began, and can lose worlds."""

    lose = -1

    def step(self, state: Any, control: Any = None, nstep: int = 1) -> Any:
        past = state.memory.get("steps", np.zeros((state.nworld, 1)))
        if self.lose >= 0 and (past == self.lose).any():
            raise DivergedError("lost", np.flatnonzero(past[:, 0] == self.lose).tolist())
        return super().step(state, control, nstep).with_memory(steps=past + 1)


class Silent(Remembering):
    """Reports nothing beyond the state."""

    reportable = frozenset()


def pair(domain: str, task: str, backend: Backend) -> tuple[Any, Any]:
    load, options = orbisim.vector.load, {"seed": 0, "task_kwargs": {"time_limit": 0.2}}
    return load(domain, task, 3, backend, **options), load(domain, task, 3, **options)


@pytest.mark.parametrize(
    ("domain", "task"), [("hopper", "hop"), ("fish", "swim"), ("reacher", "easy")]
)
def test_the_same_engine_gives_the_same(domain: str, task: str) -> None:
    mirrored, native = pair(domain, task, Remembering())
    assert mirrored.evaluation == "batched", mirrored.reason
    random, nu = np.random.default_rng(0), native.action_spec().shape[0]
    first, expected = mirrored.reset(), native.reset()
    for name, rows in expected.items():
        np.testing.assert_array_equal(first[name], rows)
    for _ in range(24):
        action = random.uniform(-1, 1, (3, nu))
        step, other = mirrored.step(action), native.step(action)
        np.testing.assert_allclose(step.reward, other.reward, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(step.truncated, other.truncated)
        for name, rows in other.observation.items():
            np.testing.assert_allclose(step.observation[name], rows, rtol=0, atol=1e-9)


def test_memory_begins_with_each_world() -> None:
    mirrored, _ = pair("cartpole", "balance", Remembering())
    mirrored.reset()
    assert "steps" not in mirrored.state.memory
    for _ in range(3):
        mirrored.step(np.zeros((3, 1)))
    mirrored.restart([1])
    for _ in range(2):
        mirrored.step(np.zeros((3, 1)))
    assert mirrored.state.memory["steps"][:, 0].tolist() == [5, 2, 5]


def test_a_world_that_the_backend_loses() -> None:
    backend = Remembering()
    mirrored, _ = pair("cartpole", "balance", backend)
    mirrored.reset()
    mirrored.step(np.zeros((3, 1)))
    mirrored.restart([1])
    mirrored.step(np.zeros((3, 1)))
    backend.lose = 1
    step = mirrored.step(np.zeros((3, 1)))
    assert mirrored.diverged.tolist() == [0, 1, 0]
    assert step.truncated.tolist() == [False, True, False]
    assert np.isfinite(step.reward).all()


class Counting(MujocoBackend):
    """C MuJoCo that notes how many worlds it is given, and can lose one that stands far out."""

    def __init__(self) -> None:
        super().__init__()
        self.given: list[int] = []

    def step(self, state: Any, control: Any = None, nstep: int = 1) -> Any:
        self.given.append(state.nworld)
        far = np.flatnonzero(np.abs(state.qpos[:, 0]) > 50.0)
        if far.size:
            raise DivergedError("lost", far.tolist())
        return super().step(state, control, nstep)


def test_the_backend_always_steps_as_many_worlds_as_there_are() -> None:
    backend = Counting()
    mirrored, native = pair("cartpole", "balance", backend)
    backend.given.clear()
    mirrored.reset(0), native.reset(0)

    def step() -> None:
        after, expected = mirrored.step(np.ones((3, 1))), native.step(np.ones((3, 1)))
        for name, rows in expected.observation.items():
            np.testing.assert_allclose(after.observation[name], rows, rtol=0, atol=1e-9)

    step()
    mirrored.restart([1]), native.restart([1])
    step()
    assert backend.given == [3, 3], "one that begins is stepped with the others"
    backend.given.clear()
    out = mirrored._simulator.physics
    out[0, 1] = 100.0  # the cart's position, after the time
    mirrored._simulator.physics = out
    lost = mirrored.step(np.ones((3, 1)))
    assert lost.truncated.tolist() == [True, False, False]
    assert mirrored.diverged.tolist() == [1, 0, 0]
    mirrored.step(np.ones((3, 1)))  # one begins, two go on
    assert backend.given == [3, 3, 3]


class Deriving(MujocoBackend):
    """C MuJoCo that gives poses and sensors itself, and notes what it is asked for."""

    derivable = frozenset({"xmat", "xpos", "xipos", "geom_xpos", "sensordata"})

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[set[str]] = []

    def derive(self, state: Any, names: Any) -> dict[str, Any]:
        self.asked.append(set(names))
        model, rows = self.model, {name: [] for name in names}
        for world in range(state.nworld):
            data = mujoco.MjData(model)
            data.qpos, data.qvel, data.act = (getattr(state, n)[world] for n in _COORDINATES)
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_sensorPos(model, data)
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_sensorVel(model, data)
            for name, found in rows.items():
                found.append(np.array(getattr(data, name)))
        return {name: np.stack(found) for name, found in rows.items()}


_COORDINATES = ("qpos", "qvel", "act")


@pytest.mark.parametrize(
    ("domain", "task", "derived"),
    [
        ("walker", "walk", {"xmat", "xpos", "sensordata"}),
        ("hopper", "hop", {"xipos", "sensordata"}),  # with touch sensors, which are reported
        ("cartpole", "balance", {"xmat"}),
    ],
)
def test_what_the_backend_derives_is_not_mirrored(
    domain: str, task: str, derived: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    backend = Deriving()
    mirrored, native = pair(domain, task, backend)
    assert mirrored.evaluation == "batched", mirrored.reason
    assert not backend.asked, "both ways of evaluation are compared over the same numbers"

    def refused() -> None:
        raise AssertionError("mirrored")

    monkeypatch.setattr(mirrored._simulator, "_mirror", refused)
    random, nu = np.random.default_rng(0), native.action_spec().shape[0]
    mirrored.reset(), native.reset()
    for _ in range(24):
        action = random.uniform(-1, 1, (3, nu))
        step, other = mirrored.step(action), native.step(action)
        np.testing.assert_allclose(step.reward, other.reward, rtol=0, atol=1e-9)
        for name, rows in other.observation.items():
            np.testing.assert_allclose(step.observation[name], rows, rtol=0, atol=1e-9)
    assert backend.asked[-1] == derived
    late = [n for n, names in enumerate(backend.asked) if names != derived]
    assert late == list(range(len(derived) - 1)), "then all at once in each step"


def test_where_models_differ_nothing_is_derived() -> None:
    backend = Deriving()
    mirrored, native = pair("reacher", "easy", backend)  # whose targets are geoms of the model
    mirrored.reset(), native.reset()
    step, other = mirrored.step(np.ones((3, 2))), native.step(np.ones((3, 2)))
    for name, rows in other.observation.items():
        np.testing.assert_allclose(step.observation[name], rows, rtol=0, atol=1e-9)
    assert not backend.asked


def test_a_task_that_reads_what_is_not_reported_is_refused() -> None:
    with pytest.raises(UnsupportedSceneError, match="'touch' reads what backend 'mujoco'"):
        orbisim.vector.load("hopper", "hop", 2, Silent(), seed=0)


def test_models_that_differ_in_what_moves_are_refused() -> None:
    with pytest.raises(UnsupportedSceneError, match="changes 'body_mass' from world to world"):
        orbisim.vector.from_environment(own.environment(), 2, Remembering(), seed=0)


def test_control_steps_must_be_whole_steps_of_the_backend(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Remembering, "timestep", property(lambda self: 0.003))
    with pytest.raises(InputError, match=r"advances 0\.003 s at a time"):
        orbisim.vector.load("cartpole", "balance", 2, Remembering(), seed=0)


@pytest.mark.slow
def test_warp() -> None:
    pytest.importorskip("mujoco_warp")
    ours = orbisim.vector.load("cartpole", "swingup", 3, "warp", "cpu", seed=0)
    native = orbisim.vector.load("cartpole", "swingup", 3, seed=0)
    ours.reset(), native.reset()
    for _ in range(20):
        action = np.full((3, 1), 0.4)
        step, expected = ours.step(action), native.step(action)
        np.testing.assert_allclose(step.reward, expected.reward, atol=1e-4)
        for name, rows in expected.observation.items():
            np.testing.assert_allclose(step.observation[name], rows, atol=1e-3)


@pytest.mark.slow
def test_learned() -> None:
    pytest.importorskip("torch")
    ours = orbisim.vector.load("pendulum", "swingup", 3, "learned", "cpu", seed=0)
    native = orbisim.vector.load("pendulum", "swingup", 3, seed=0)
    ours.reset(), native.reset()
    for _ in range(5):
        step, expected = ours.step(np.ones((3, 1))), native.step(np.ones((3, 1)))
        np.testing.assert_allclose(
            step.observation["orientation"], expected.observation["orientation"], atol=0.02
        )
