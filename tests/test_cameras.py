"""Cameras as values: where MuJoCo puts them, and the way to pixels and back."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim.cameras import Camera, Orbit, camera_number, free_orbit, read_camera, read_focal
from orbisim.errors import InputError, UnknownNameError

SCENE = """
<mujoco>
  <worldbody>
    <geom size="0.1"/>
    <body name="arm" pos="0 0 1">
      <joint name="hinge" axis="0 0 1"/>
      <geom size="0.05"/>
      <camera name="wrist" pos="0.3 0 0" fovy="60"/>
    </body>
    <camera name="flat" projection="orthographic" fovy="1"/>
    <camera name="lens" sensorsize="0.02 0.01" focal="0.02 0.03" resolution="64 32"/>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(SCENE)


def test_a_camera_on_a_body_moves_with_it(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    data.qpos[0] = np.pi / 2
    mujoco.mj_forward(model, data)
    camera = read_camera(model, data, camera_number(model, "wrist"))
    np.testing.assert_allclose(camera.pos, [0.0, 0.3, 1.0], atol=1e-9)
    assert camera.fovy == pytest.approx(60.0)


def test_focal_lengths_of_a_lens_are_in_image_heights(model: mujoco.MjModel) -> None:
    assert read_focal(model, camera_number(model, "lens")) == pytest.approx((2.0, 3.0))


def test_the_free_camera_is_mujocos(model: mujoco.MjModel) -> None:
    orbit, data = free_orbit(model), mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    scene, camera = mujoco.MjvScene(model, 100), mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    mujoco.mjv_updateScene(
        model, data, mujoco.MjvOption(), None, camera, mujoco.mjtCatBit.mjCAT_ALL.value, scene
    )
    ours = orbit.camera(45.0)
    eye = (np.array(scene.camera[0].pos) + np.array(scene.camera[1].pos)) / 2
    np.testing.assert_allclose(ours.pos, eye, atol=1e-5)
    np.testing.assert_allclose(-ours.rot[:, 2], scene.camera[0].forward, atol=1e-5)
    np.testing.assert_allclose(ours.rot[:, 1], scene.camera[0].up, atol=1e-5)


def test_intrinsics_there_and_back() -> None:
    camera = Camera(np.zeros(3), np.eye(3), (1.2, 1.3), (0.02, -0.03))
    matrix = camera.intrinsics(48, 64)
    assert matrix[0, 2] == pytest.approx(32 + 48 * 0.02)
    again = Camera.from_intrinsics(camera.pos, camera.rot, matrix, 48, 64)
    assert (*again.focal, *again.offset) == pytest.approx((*camera.focal, *camera.offset))


def test_what_is_no_camera_is_refused(model: mujoco.MjModel) -> None:
    with pytest.raises(InputError, match="orthonormal"):
        Camera(np.zeros(3), 2 * np.eye(3), (1.0, 1.0))
    with pytest.raises(InputError, match="above 0"):
        Camera(np.zeros(3), np.eye(3), (0.0, 1.0))
    with pytest.raises(InputError, match="field of view"):
        Orbit((0.0, 0.0, 0.0), 1.0, 0.0, 0.0).camera(0.0)
    with pytest.raises(InputError, match="orthographic"):
        read_focal(model, camera_number(model, "flat"))
    with pytest.raises(UnknownNameError, match="did you mean 'wrist'"):
        camera_number(model, "wrst")
    with pytest.raises(InputError, match="does not exist"):
        camera_number(model, 7)
