"""Actuators from transmissions and limits."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim.scene import Scene
from orbisim.scene.urdf import read_urdf_string
from tests.scene.urdf.urdf_text import joint, link, robot

LIMIT = "<limit lower='-1' upper='2' effort='10' velocity='4'/>"


def transmission(joint_name: str, reduction: str = "", actuator: str = "m") -> str:
    inside = f"<mechanicalReduction>{reduction}</mechanicalReduction>" if reduction else ""
    return (
        f"<transmission name='t_{joint_name}'><type>transmission_interface/SimpleTransmission"
        f"</type><joint name='{joint_name}'/><actuator name='{actuator}'>{inside}</actuator>"
        "</transmission>"
    )


def arm(*extra: str) -> str:
    return robot(
        *(link(name) for name in "abcd"),
        joint("j1", "a", "b", LIMIT),
        joint("j2", "b", "c", LIMIT),
        joint("j3", "c", "d", LIMIT, "<mimic joint='j2'/>"),
        *extra,
    )


def read(text: str, **options) -> Scene:
    return Scene.from_read(read_urdf_string(text, **options), "test")


def test_none_by_default_and_transmissions_are_listed() -> None:
    scene = read(arm(transmission("j1")))
    assert scene.model.nu == 0
    assert "<transmission>" in [item.feature for item in scene.unsupported]


def test_motor_works_through_its_reduction() -> None:
    scene = read(arm(transmission("j1", "50")), actuators="motor")
    model = scene.model
    assert [model.actuator(i).name for i in range(model.nu)] == ["m"]
    assert model.actuator_gear[0, 0] == 50
    np.testing.assert_allclose(model.actuator_forcerange[0], [-0.2, 0.2])
    np.testing.assert_allclose(model.actuator_ctrlrange[0], [-0.2, 0.2])
    data = mujoco.MjData(model)
    data.ctrl[0] = 0.1
    mujoco.mj_forward(model, data)
    assert data.qfrc_actuator[0] == pytest.approx(5.0)


def test_position_ranges_are_those_of_the_joint_times_the_reduction() -> None:
    scene = read(arm(transmission("j1", "-2")), actuators="position", position_gain=7)
    model = scene.model
    np.testing.assert_allclose(model.actuator_ctrlrange[0], [-4, 2])
    assert model.actuator_gainprm[0, 0] == 7
    data = mujoco.MjData(model)
    data.qpos[0] = 1.0
    data.ctrl[0] = -2.0  # where the joint is
    mujoco.mj_forward(model, data)
    assert data.actuator_force[0] == pytest.approx(0.0, abs=1e-12)


def test_velocity_range_is_the_velocity_limit() -> None:
    model = read(arm(transmission("j1", "3")), actuators="velocity").model
    np.testing.assert_allclose(model.actuator_ctrlrange[0], [-12, 12])
    np.testing.assert_allclose(model.actuator_forcerange[0], [-10 / 3, 10 / 3])


def test_all_joints_but_followers_on_request() -> None:
    options = {"actuators": "motor", "actuate": "all"}
    model = read(arm(transmission("j2", "2")), **options).model
    assert [model.actuator(i).name for i in range(model.nu)] == ["m", "j1"]
    np.testing.assert_array_equal(model.actuator_gear[:, 0], [2, 1])


def test_nothing_to_drive_is_said() -> None:
    scene = read(arm(), actuators="motor")
    assert scene.model.nu == 0
    assert any("--actuators on the command line" in warning for warning in scene.warnings)


def test_gains_are_said_to_be_assumed() -> None:
    scene = read(arm(transmission("j1")), actuators="position")
    assert any("position_gain=..." in warning for warning in scene.warnings)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (transmission("gone"), "drives 'gone', which is not a joint"),
        (transmission("j1", "0"), "mechanicalReduction='0'"),
        (transmission("j1", "reduction"), "mechanicalReduction='reduction'"),
    ],
)
def test_transmissions_that_cannot_be_used_are_listed(text: str, says: str) -> None:
    scene = read(arm(text), actuators="motor")
    assert scene.model.nu == 0
    assert any(says in item.feature for item in scene.unsupported)


def test_names_are_unique() -> None:
    scene = read(arm(transmission("j1"), transmission("j2")), actuators="motor")
    assert [scene.model.actuator(i).name for i in range(2)] == ["m", "m_2"]


def test_reduction_in_the_transmission_itself() -> None:
    old = (
        "<transmission type='pr2_mechanism_model/SimpleTransmission' name='t'>"
        "<actuator name='m'/><joint name='j1'/><mechanicalReduction>9</mechanicalReduction>"
        "</transmission>"
    )
    assert read(arm(old), actuators="motor").model.actuator_gear[0, 0] == 9
