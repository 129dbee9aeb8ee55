"""Motions that make missing effects visible."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import mjcf_assets
from orbisim import Scene, load_scene
from orbisim.errors import InputError
from orbisim.testing.excitation import (
    Plan,
    _angles,
    default_duration,
    excite,
    glide,
    is_servo,
    program,
)

ASSETS = Path(mjcf_assets.__file__).parent


def asset(name: str) -> Scene:
    return load_scene(ASSETS / name / "scene.xml")


@pytest.mark.parametrize("seed", range(4))
def test_a_program_fills_its_range_at_its_rates(seed: int) -> None:
    signal = program(np.random.default_rng(seed), 4000, 100.0, fast=2.0)
    assert np.abs(signal).max() <= 1.0
    assert signal.std() > 0.15
    power = np.abs(np.fft.rfft(signal - signal.mean())) ** 2
    frequency = np.fft.rfftfreq(4000, 0.01)
    assert power[frequency > 15].sum() < 0.01 * power.sum()


def test_a_glide_stops_at_its_knots() -> None:
    knots, values = np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0, -1.0])
    path = glide(np.array([0.0, 0.5, 1.0, 2.0, 3.0, 9.0]), knots, values)
    np.testing.assert_allclose(path, [0.0, 1.0, 2.0, 0.5, -1.0, -1.0])
    eps = 1e-5
    near = glide(np.array([1 - eps, 1 + eps]), knots, values)
    np.testing.assert_allclose(near, 2.0, atol=1e-9)  # at rest there


def test_the_angles_of_an_orientation() -> None:
    roll, pitch, yaw = 0.3, -0.4, 1.2
    quat, part = np.array([1.0, 0, 0, 0]), np.empty(4)
    for axis, angle in (((0, 0, 1), yaw), ((0, 1, 0), pitch), ((1, 0, 0), roll)):
        mujoco.mju_axisAngle2Quat(part, np.array(axis, float), angle)
        mujoco.mju_mulQuat(quat, quat.copy(), part)
    np.testing.assert_allclose(np.ravel(_angles(quat[None])), [roll, pitch, yaw], atol=1e-12)


def test_servos_start_where_they_are_told_to_be() -> None:
    scene = asset("arm2")
    model = scene.model
    plan = excite(scene, episodes=3, duration=0.5)
    for u in range(model.nu):
        if is_servo(model, u):
            data = mujoco.MjData(model)
            data.qpos[:], data.ctrl[:] = plan.qpos[0], plan.reference[0, 0]
            mujoco.mj_forward(model, data)
            assert data.actuator_force[u] == pytest.approx(0.0, abs=1e-9)


def test_a_flying_body_stays_where_it_should() -> None:
    scene = asset("drone")
    plan = excite(scene, episodes=1, duration=0.1)
    goal = np.array([[0.2, -0.1, 1.3, 0.5]])  # position and heading
    data = mujoco.MjData(scene.model)
    data.qpos[:], data.qvel[:] = plan.qpos[0], plan.qvel[0]
    assert plan.feedback is not None
    for _ in range(600):
        data.ctrl[:] = plan.feedback(goal, data.qpos[None], data.qvel[None])[0]
        mujoco.mj_step(scene.model, data, round(0.01 / scene.model.opt.timestep))
    np.testing.assert_allclose(data.qpos[:3], goal[0, :3], atol=0.02)
    assert _angles(data.qpos[None, 3:])[2] == pytest.approx(0.5, abs=0.05)


def test_the_seed_decides() -> None:
    scene = asset("cart_pole")
    first, again, other = (excite(scene, duration=1.0, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.reference, again.reference)
    assert not np.array_equal(first.reference, other.reference)


def test_throws_are_short() -> None:
    assert default_duration(asset("bouncing_ball")) == 1.5
    assert default_duration(asset("arm2")) == 8.0
    ball = excite(asset("bouncing_ball"), episodes=5)
    assert ball.reference.shape == (5, 150, 0)
    assert (np.linalg.norm(ball.qvel[:, :2], axis=1) > 0.4).all()


def test_a_plan_rests_at_the_reference() -> None:
    scene = asset("arm2")
    qpos, qvel = Plan(scene, 2, 10, 50.0, np.random.default_rng(0)).rest()
    np.testing.assert_array_equal(qpos, [scene.model.qpos0] * 2)
    assert not qvel.any()


@pytest.mark.parametrize(
    "changes", [{"duration": 0.0}, {"rate": -1.0}, {"episodes": 0}, {"duration": float("nan")}]
)
def test_what_cannot_be_is_refused(changes: dict) -> None:
    with pytest.raises(InputError, match=r"must be positive|at least one episode"):
        excite(asset("arm2"), **changes)


def test_nothing_to_move() -> None:
    still = load_scene("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    with pytest.raises(InputError, match="no joints to move"):
        excite(still)
