"""The arms against published kinematics, and their controller."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt
import pytest

from orbisim.scene import load_scene
from orbisim.tasks import assets
from orbisim.tasks.arm import PANDA, UR5E, ArmConfig, ArmController, pointing_down

Floats = npt.NDArray[np.float64]

UR5E_DH = [
    (0.1625, 0.0, np.pi / 2),
    (0.0, -0.425, 0.0),
    (0.0, -0.3922, 0.0),
    (0.1333, 0.0, np.pi / 2),
    (0.0997, 0.0, -np.pi / 2),
    (0.0996, 0.0, 0.0),
]
"""d, a, alpha of the standard convention, m and rad."""

PANDA_DH = [
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -np.pi / 2),
    (0.0, 0.316, np.pi / 2),
    (0.0825, 0.0, np.pi / 2),
    (-0.0825, 0.384, -np.pi / 2),
    (0.0, 0.0, np.pi / 2),
    (0.088, 0.0, np.pi / 2),
]
"""a, d, alpha of Craig's convention, m and rad."""


def turn_z(angle: float) -> Floats:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def turn_x(angle: float) -> Floats:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])


def shift(x: float, y: float, z: float) -> Floats:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def pose_of(name: str, body: str, angles: Floats) -> Floats:
    model = load_scene(str(assets.path(name))).model
    data = mujoco.MjData(model)
    data.qpos[: len(angles)] = angles
    mujoco.mj_kinematics(model, data)
    pose = np.eye(4)
    pose[:3, 3] = data.body(body).xpos
    pose[:3, :3] = data.body(body).xmat.reshape(3, 3)
    return pose


@pytest.mark.parametrize("seed", range(3))
def test_ur5e_is_the_published_chain(seed: int) -> None:
    angles = np.random.default_rng(seed).uniform(-2, 2, 6)
    expected = turn_z(np.pi)
    for angle, (d, a, alpha) in zip(angles, UR5E_DH, strict=True):
        expected = expected @ turn_z(angle) @ shift(a, 0, d) @ turn_x(alpha)
    np.testing.assert_allclose(pose_of("ur5e", "gripper", angles), expected, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_panda_is_the_published_chain(seed: int) -> None:
    angles = np.random.default_rng(seed).uniform(-1, 1, 7)
    expected = np.eye(4)
    for angle, (a, d, alpha) in zip(angles, PANDA_DH, strict=True):
        expected = expected @ turn_x(alpha) @ shift(a, 0, 0) @ turn_z(angle) @ shift(0, 0, d)
    expected = expected @ shift(0, 0, 0.107) @ turn_z(-np.pi / 4)
    np.testing.assert_allclose(pose_of("panda", "hand", angles), expected, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "mass"), [("ur5e", 18.625), ("panda", 16.822)], ids=["ur5e", "panda"]
)
def test_moving_mass_is_the_published_one(name: str, mass: float) -> None:
    model = load_scene(str(assets.path(name))).model
    moving = model.body_weldid != 0
    assert model.body_mass[moving].sum() == pytest.approx(mass, abs=2e-3)


@pytest.mark.parametrize("config", [UR5E, PANDA], ids=["ur5e", "panda"])
@pytest.mark.parametrize("spot", [(0.4, -0.2, 0.03), (0.6, 0.2, 0.2)])
def test_solve_reaches_and_points_down(config: ArmConfig, spot: tuple[float, float, float]) -> None:
    arm = ArmController(config)
    arm.solve(spot, 0.5)
    np.testing.assert_allclose(arm.pos, spot, atol=1e-4)
    np.testing.assert_allclose(arm.rot, pointing_down(0.5), atol=1e-3)


@pytest.mark.parametrize("config", [UR5E, PANDA], ids=["ur5e", "panda"])
def test_actions_move_the_commanded_pose_as_they_say(config: ArmConfig) -> None:
    arm = ArmController(config)
    arm.reset(arm.solve((0.5, 0.0, 0.15), 0.0))
    before = arm.pos
    control = arm.step(np.array([0.01, -0.02, 0.005, 0.0, 0.0, 0.1, 1.0]))
    np.testing.assert_allclose(arm.pos - before, [0.01, -0.02, 0.005], atol=2e-4)
    np.testing.assert_allclose(arm.rot, pointing_down(0.1), atol=2e-3)
    assert control.shape == (config.joints + 1,)
    assert control[-1] == 0.0


def test_controls_are_a_function_of_the_first_target_and_the_actions() -> None:
    arm, rng = ArmController(UR5E), np.random.default_rng(0)
    start = arm.solve((0.5, 0.0, 0.15), 0.0)
    actions = rng.normal(0, 0.01, (20, 7))
    runs = []
    for _ in range(2):
        arm.reset(start)
        runs.append([arm.step(action) for action in actions])
    np.testing.assert_array_equal(*runs)


def test_steps_are_bounded() -> None:
    arm = ArmController(UR5E)
    arm.reset(arm.solve((0.5, 0.0, 0.15), 0.0))
    target = arm.target
    arm.step(np.array([5.0, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0]))
    assert np.abs(arm.target - target).max() <= UR5E.stride + 1e-12
