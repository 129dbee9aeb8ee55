"""Newton's example in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim.tasks.ball_reference import BallConfig, acceleration, loss, simulate


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


def test_planes_push_only_what_touches_them() -> None:
    config = BallConfig()
    air, rest = np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.05]]), np.zeros((2, 3))
    found = acceleration(config, air, rest)
    np.testing.assert_allclose(found, [[0, 0, -9.81], [0, 0, 1e4 * 0.05 - 9.81]])
    falling = acceleration(config, air[1], np.array([0.0, 0.0, -2.0]))
    rising = acceleration(config, air[1], np.array([0.0, 0.0, 2.0]))
    np.testing.assert_allclose(falling[2] - rising[2], 10.0 * 2.0)  # damped on approach only
