"""Recordings of simulations, with the imperfections of measured ones."""

from __future__ import annotations

import numpy as np
import pytest

import orbisim
from orbisim import load_scene
from orbisim.errors import InputError
from orbisim.recording import capture, noise_std, resample
from orbisim.recording import quaternions as quat
from orbisim.recording.noise import lattice_step

from .scenes import EVERYTHING, simulate


@pytest.fixture(scope="module")
def scene():
    return load_scene(EVERYTHING)


@pytest.fixture(scope="module")
def trajectory(scene):
    return simulate(scene, 1000)


def test_everything_is_recorded(scene, trajectory):
    recording = capture(scene, trajectory, bodies=["lower"])
    assert len(recording) == 1001
    np.testing.assert_allclose(recording.time, np.arange(1001) * 0.002, atol=1e-12)
    np.testing.assert_array_equal(recording["qpos/elbow"][1:], trajectory.qpos[0, :, 1])
    np.testing.assert_array_equal(recording["qvel/cube"][1:], trajectory.qvel[0, :, 2 + 0 : 8])
    np.testing.assert_array_equal(recording["ctrl/elbow"][:-1], trajectory.control[0, :, 1])
    np.testing.assert_array_equal(recording["sensor/imu"][:-1], trajectory.sensordata[0, :, 1:])
    assert np.isnan(recording["sensor/imu"][-1]).all()
    assert recording["xquat/lower"].shape == (1001, 4)


def test_rate(scene, trajectory):
    slow = capture(scene, trajectory, rate=100.0, velocities=False)
    full = capture(scene, trajectory)
    assert len(slow) == 201
    assert not any(name.startswith("qvel") for name in slow.signals)
    np.testing.assert_allclose(slow["qpos/cube"], full["qpos/cube"][::5], atol=1e-12)
    np.testing.assert_array_equal(slow["ctrl/shoulder"][:-1], full["ctrl/shoulder"][:-1:5])
    odd = capture(scene, trajectory, rate=333.0)
    between = resample(full, odd.time)
    np.testing.assert_allclose(odd["qpos/elbow"], between["qpos/elbow"], atol=1e-4)
    inside = np.abs(odd.time / 0.002 - np.round(odd.time / 0.002)) > 1e-6
    np.testing.assert_array_equal(odd["ctrl/elbow"][inside], between["ctrl/elbow"][inside])


def test_noise_and_resolution(scene, trajectory):
    clean = capture(scene, trajectory)
    noisy = capture(
        scene,
        trajectory,
        noise={"qpos": 1e-3, "qpos/shoulder": 1e-2, "qvel/elbow": 0.5},
        resolution={"qpos/rail": 0.01},
        seed=3,
    )
    assert noise_std(noisy.time, noisy["qpos/elbow"]) == pytest.approx(1e-3, rel=0.15)
    assert noise_std(noisy.time, noisy["qpos/shoulder"]) == pytest.approx(1e-2, rel=0.15)
    assert np.std(noisy["qvel/elbow"] - clean["qvel/elbow"]) == pytest.approx(0.5, rel=0.1)
    np.testing.assert_array_equal(noisy["qvel/shoulder"], clean["qvel/shoulder"])
    assert lattice_step(noisy["qpos/rail"]) == pytest.approx(0.01)
    for name, place in (("qpos/cube", slice(3, 7)), ("qpos/socket", slice(0, 4))):
        a, b = clean[name][:, place], noisy[name][:, place]
        turn = quat.log(quat.multiply(quat.conjugate(a), b))
        np.testing.assert_allclose(turn.std(axis=0), 1e-3, rtol=0.15)
        np.testing.assert_allclose(np.linalg.norm(b, axis=1), 1, rtol=1e-12)
    again = capture(scene, trajectory, noise=1e-3, seed=3)
    assert again == capture(scene, trajectory, noise=1e-3, seed=3)
    assert again != capture(scene, trajectory, noise=1e-3, seed=4)


def test_scenes_without_names():
    scene = load_scene(
        "<mujoco><worldbody><body><joint/><geom size='.1'/></body></worldbody>"
        "<actuator><motor joint='j'/></actuator></mujoco>".replace("<joint/>", "<joint name='j'/>")
    )
    model = scene.model
    assert not model.actuator(0).name
    backend = orbisim.make_backend("mujoco", scene)
    trajectory = backend.rollout(backend.reset(1), np.ones((5, 1)))
    assert set(capture(scene, trajectory).signals) == {"qpos/j", "qvel/j", "ctrl"}


def test_wrong_arguments(scene, trajectory):
    with pytest.raises(InputError, match="world 1 is not among the trajectory's 1"):
        capture(scene, trajectory, world=1)
    with pytest.raises(InputError, match="no body 'hand' to record"):
        capture(scene, trajectory, bodies=["hand"])
    with pytest.raises(InputError, match="noise names 'qpos/wrist'"):
        capture(scene, trajectory, noise={"qpos/wrist": 1.0})
