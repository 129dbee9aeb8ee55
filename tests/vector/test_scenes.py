"""A scene and a reward are an environment."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.effects.base import EffectInstance
from orbisim.effects.carry import add_effects
from orbisim.errors import InputError
from orbisim.vector import from_scene, intervals
from orbisim.vector.scenes import SceneTask
from tests.vector import own


def upright(physics: Any) -> Any:
    return -np.linalg.norm(physics.named.data.qpos["x"] - 0.5)


def anywhere(physics: Any, random: Any) -> None:
    physics.named.data.qpos["x"] = random.uniform(-0.1, 0.1)


def test_rewards_observations_and_ends() -> None:
    environment = from_scene(
        own.XML,
        3,
        reward=upright,
        termination=lambda physics: physics.named.data.qpos["x"][0] > 0.12,
        initialize=anywhere,
        time_limit=0.4,
        control_timestep=0.02,
        seed=0,
    )
    assert environment.evaluation == "batched", environment.reason
    first = environment.reset()
    np.testing.assert_array_equal(first["position"][:, 0], environment.state.qpos[:, 0])
    assert len(set(first["position"][:, 0])) == 3
    terminated = truncated = 0
    for _ in range(60):
        step = environment.step(np.full((3, 1), 0.5))
        terminated += step.terminated.sum()
        truncated += step.truncated.sum()
        begun = environment.state.time > 0
        expected = -np.abs(step.observation["position"][:, 0] - 0.5)
        np.testing.assert_array_equal(step.reward[begun], expected[begun])
        assert (step.observation["position"][step.terminated, 0] > 0.12).all()
    assert terminated >= 3 and not truncated


def test_tasks_of_ours() -> None:
    environment = from_scene(
        "task:push", 2, reward=lambda physics: -np.sum(physics.data.qvel**2), control_timestep=0.04
    )
    environment.reset()
    nu = environment.action_spec().shape[0]
    assert environment.step(np.zeros((2, nu))).reward.shape == (2,)


def test_effects_that_act_between_timesteps() -> None:
    """They are carried by the scene, and applied."""
    scene = orbisim.load_scene(own.XML)
    values = {"coulomb": 4.0, "static": 5.0, "velocity": 0.05}
    drag = add_effects(scene, [EffectInstance("stribeck_friction", "x", values)])
    runs = []
    for one in (scene, drag):
        environment = from_scene(one, 2, reward=upright, seed=0)
        environment.reset()
        for _ in range(20):
            environment.step(np.ones((2, 1)))
        runs.append(environment.state.qvel[0, 0])
    assert runs[1] < 0.9 * runs[0]


def report(effect: str = "viscous_damping", **more: Any) -> dict[str, Any]:
    parameters = {"coefficient": {"value": 2.0, "unit": "N*s/m", "ci95": [1.0, 3.0]}}
    one = {"effect": effect, "target": "x", "parameters": parameters, **more}
    return {"schema": "orbisim.diagnosis/1", "verdict": "explained", "effects": [one]}


def test_worlds_drawn_from_a_diagnosis() -> None:
    environment = from_scene(own.XML, 6, reward=upright, seed=3, randomize=intervals(report()))
    damping = environment._fields.varied["dof_damping"].reshape(6, -1)[:, 0]
    assert len(set(damping)) == 6 and (damping >= 1.0).all() and (damping <= 3.0).all()
    environment.reset()
    for _ in range(10):
        environment.step(np.ones((6, 1)))
    speeds = environment.state.qvel[:, 0]
    np.testing.assert_array_equal(np.argsort(speeds), np.argsort(-damping))
    again = from_scene(own.XML, 6, reward=upright, seed=3, randomize=intervals(report()))
    np.testing.assert_array_equal(
        again._fields.varied["dof_damping"], environment._fields.varied["dof_damping"]
    )


def test_worlds_drawn_with_delays_are_those_of_their_own_scenes() -> None:
    """A longer delay needs a longer history, and all worlds have states of one size."""
    parameters = {"delay": {"value": 0.05, "unit": "s", "ci95": [0.01, 0.1]}}
    found = report("actuator_delay", target="push", parameters=parameters)
    scene, count = orbisim.load_scene(own.XML), 5
    environment = from_scene(scene, count, reward=upright, seed=0, randomize=intervals(found))
    environment.reset()
    scenes = [intervals(found).draw(scene, seed) for seed in range(count)]
    assert len({int(one.model.nhistory) for one in scenes}) == 1
    assert len({float(one.model.actuator_delay[0]) for one in scenes}) == count
    for _ in range(15):
        environment.step(np.ones((count, 1)))
    for world, one in enumerate(scenes):
        data = mujoco.MjData(one.model)
        data.ctrl[:] = 1.0
        mujoco.mj_step(one.model, data, 15)
        np.testing.assert_array_equal(environment.state.qvel[world], data.qvel)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"time_limit": -1.0}, "time_limit"),
        ({"control_timestep": 0.015}, "must be a multiple"),
    ],
)
def test_durations_that_are_none(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        from_scene(own.XML, 2, reward=upright, **options)


def test_the_default_observation() -> None:
    task = SceneTask(upright, None, None, None, random=0)
    physics = own.Ball.from_xml_string(own.XML)
    assert list(task.get_observation(physics)) == ["position", "velocity"]
    assert task.get_termination(physics) is None
