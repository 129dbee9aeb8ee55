"""USD: units, up axis, gravity and what is assumed where they are not authored."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from orbisim.errors import InputError, SceneError
from orbisim.scene import load_scene
from tests.scene.usd.usd_text import DATA, body, load, stage, write

DEGREE = math.pi / 180


def test_centimetres_grams_and_y_up() -> None:
    model = load_scene(DATA / "units.usda").model
    np.testing.assert_allclose(model.opt.gravity, [0, 0, -9.81], atol=1e-15)
    water, rod = model.body("Water"), model.body("Rod")
    np.testing.assert_allclose(water.pos, [0.1, -0.3, 0.2], atol=1e-15)  # (x, -z, y)
    np.testing.assert_allclose(water.mass, 1.0, rtol=1e-12)  # 1 g/cm^3, 1 litre
    np.testing.assert_allclose(model.geom("Water").size, [0.05] * 3)
    np.testing.assert_allclose(rod.mass, 0.5)
    np.testing.assert_allclose(rod.inertia, [0.002, 0.001, 0.002], atol=1e-15)
    # the rod's own frame keeps its axes, so that its centre of mass is along its -y
    np.testing.assert_allclose(rod.ipos, [0, -0.2, 0], atol=1e-15)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.body("Rod").xipos, [1.0, 0, 0.8], atol=1e-15)


def test_a_hinge_and_its_drive_in_centimetres_grams_and_degrees() -> None:
    model = load_scene(DATA / "units.usda").model
    np.testing.assert_allclose(model.joint("Hinge").range, [-90 * DEGREE, 45 * DEGREE])
    actuator = model.actuator("Hinge")
    stiffness = 100000 * 1e-3 * 1e-4 / DEGREE  # g cm^2/s^2 per degree in N m per rad
    assert actuator.gainprm[0] == pytest.approx(stiffness, rel=1e-6)
    assert actuator.biasprm[1] == pytest.approx(-stiffness, rel=1e-6)
    assert actuator.biasprm[2] == pytest.approx(-stiffness / 5, rel=1e-6)
    np.testing.assert_allclose(actuator.forcerange, [-10, 10], rtol=1e-6)
    key = model.key("initial")
    np.testing.assert_allclose(key.ctrl, [30 * DEGREE])


def test_the_plane_faces_up_and_carries_the_cube() -> None:
    model = load_scene(DATA / "units.usda").model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    normal = data.geom("Floor").xmat.reshape(3, 3)[:, 2]
    np.testing.assert_allclose(normal, [0, 0, 1], atol=1e-15)
    for _ in range(1000):
        mujoco.mj_step(model, data)
    assert data.body("Water").xpos[2] == pytest.approx(0.05, abs=1e-3)


def test_velocities_are_in_the_keyframe() -> None:
    scene = load_scene(DATA / "units.usda")
    model, data = scene.model, mujoco.MjData(scene.model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(
        model, data, mujoco.mjtObj.mjOBJ_BODY, model.body("Water").id, velocity, 0
    )
    # 90 degrees/s about the stage's z, which is -y here; 30 cm/s along the stage's y
    np.testing.assert_allclose(velocity, [0, -math.pi / 2, 0, 0, 0, 0.3], atol=1e-9)
    assert any("initial velocities" in warning for warning in scene.warnings)


GRAVITIES = {
    "": (0, 0, -9.81),
    "float physics:gravityMagnitude = 5": (0, 0, -5),
    "float physics:gravityMagnitude = 0": (0, 0, 0),
    "vector3f physics:gravityDirection = (0, 3, -4)": (0, 5.886, -7.848),
    "float physics:gravityMagnitude = -inf": (0, 0, -9.81),
}


@pytest.mark.parametrize("authored", GRAVITIES)
def test_gravity(tmp_path: Path, authored: str) -> None:
    text = f"""#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Z"
)
def PhysicsScene "P"
{{
    {authored}
}}
{body("B")}"""
    model = load_scene(write(tmp_path, text)).model
    np.testing.assert_allclose(model.opt.gravity, GRAVITIES[authored], atol=1e-12)


def test_earth_gravity_does_not_scale_with_the_unit(tmp_path: Path) -> None:
    model = load(tmp_path, body("B"), meters=0.01).model
    np.testing.assert_allclose(model.opt.gravity, [0, 0, -9.81])


def test_what_is_assumed_is_said_and_can_be_overridden(tmp_path: Path) -> None:
    path = write(tmp_path, "#usda 1.0\n" + body("B", pos=(0, 2, 0)))
    scene = load_scene(path)
    np.testing.assert_allclose(scene.model.body("B").pos, [0, 0, 0.02], atol=1e-15)
    text = " ".join(scene.warnings)
    assert "metersPerUnit" in text and "upAxis" in text and "PhysicsScene" in text
    model = load_scene(path, meters_per_unit=1.0, up_axis="Z").model
    np.testing.assert_allclose(model.body("B").pos, [0, 2, 0])


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"meters_per_unit": -1.0}, "meters_per_unit must be a positive number"),
        ({"up_axis": "X"}, "up_axis must be 'Y' or 'Z'"),
        ({"floating": True}, "no option 'floating'"),
    ],
)
def test_wrong_options(tmp_path: Path, option: dict, message: str) -> None:
    path = write(tmp_path, stage(body("B")))
    with pytest.raises(InputError, match=message):
        load_scene(path, **option)


@pytest.mark.parametrize("unit", ["metersPerUnit = 0", "kilogramsPerUnit = -1"])
def test_units_that_make_no_sense(tmp_path: Path, unit: str) -> None:
    path = write(tmp_path, f"#usda 1.0\n(\n{unit}\n)\n" + body("B"))
    with pytest.raises(SceneError, match="expected a positive number"):
        load_scene(path)
