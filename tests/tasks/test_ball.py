"""The ball: Newton's example, in NumPy and in MJCF."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim import tasks
from orbisim.tasks.ball_reference import BallConfig, loss, simulate


def test_newtons_solution_hits_the_target() -> None:
    positions, _ = simulate([0.0, 10.639, -4.282])
    np.testing.assert_allclose(positions[-1], [0.0, -2.001, 1.500], atol=5e-4)
    assert loss(positions[-1]) == pytest.approx(1.0e-6, abs=5e-7)


def test_the_velocity_of_the_paper_misses_by_23_cm() -> None:
    positions, _ = simulate([-0.07, 11.218, -4.238])
    assert np.sqrt(loss(positions[-1])) == pytest.approx(0.231, abs=0.002)


def test_a_batch_gives_the_same_as_one_at_a_time() -> None:
    velocities = np.array([[0.0, 5.0, -5.0], [0.3, 9.0, -3.0]])
    together, _ = simulate(velocities)
    for i, velocity in enumerate(velocities):
        np.testing.assert_array_equal(together[:, i], simulate(velocity)[0])


def test_free_flight_is_a_parabola() -> None:
    config = BallConfig(planes=())
    positions, velocities = simulate([1.0, 2.0, 3.0], config=config)
    time = config.frames * config.frame_time
    np.testing.assert_allclose(velocities[-1], [1.0, 2.0, 3.0 - 9.81 * time], rtol=1e-12)
    step = config.frame_time / config.substeps  # semi-implicit Euler falls g t dt / 2 further
    fall = 9.81 * time * (time + step) / 2
    np.testing.assert_allclose(positions[-1, 2], 1.0 + 3.0 * time - fall, rtol=1e-12)


def test_bounces_lose_speed_as_damping_on_approach_says() -> None:
    config = BallConfig(gravity=0.0)
    _, velocities = simulate([0.0, 5.0, 0.0], config=config)
    ratio = config.damping / (2 * np.sqrt(config.stiffness * config.mass))
    assert velocities[-1, 1] == pytest.approx(-5.0 * np.exp(-np.pi * ratio / 2), rel=0.02)


def test_episodes_come_from_the_reference() -> None:
    episode = tasks.make("ball").episode("throw", 5)
    start = episode.arrays["qvel"][0, :3]
    positions, _ = simulate(start)
    np.testing.assert_array_equal(episode.arrays["qpos"][:, :3], positions)
    assert episode.steps == 36
    assert episode.arrays["objects/pos"].shape == (37, 1, 3)


def test_the_mjcf_scene_bounces_alike() -> None:
    model = tasks.make("ball").scene().model
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 288)
    positions, _ = simulate(BallConfig().velocity)
    assert np.linalg.norm(data.qpos[:3] - positions[-1]) < 0.02
