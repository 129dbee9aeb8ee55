"""The scenes of the measured systems: declared ones without effects, published ones with them."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from orbisim import load_scene

ASSETS = Path(__file__).resolve().parents[2] / "mjcf_assets"
NAMES = (
    "acromonk",
    "airtrack_oscillator",
    "bam_xl330",
    "contactnets_cube",
    "dfki_double_pendulum_A",
    "dfki_simple_pendulum",
    "emps",
    "kuka_kr300",
    "multiarm_pendulum_double",
    "multiarm_pendulum_single",
    "rocket_coast",
    "schmidt_lipson_double_pendulum",
    "staubli_tx40",
    "sts3215_backlash",
    "table_tennis_ball",
)
DECLARED = {
    ("sts3215_backlash", "actuator_biasprm"),  # a position servo
    ("bam_xl330", "actuator_biasprm"),  # the motor's back electromotive force
    ("airtrack_oscillator", "jnt_stiffness"),  # a glider between springs
}
"""What would be an effect elsewhere."""
UNPUBLISHED = ("sts3215_backlash", "schmidt_lipson_double_pendulum")
EFFECTS = ("dof_damping", "dof_frictionloss", "jnt_stiffness", "actuator_biasprm")


def model(name, kind="scene"):
    return load_scene(ASSETS / name / f"{kind}.xml").model


@pytest.mark.parametrize("name", NAMES)
def test_declared_scenes_have_no_effects(name):
    declared = model(name)
    for field in EFFECTS:
        values = np.array(getattr(declared, field))
        assert (name, field) in DECLARED or not values.any(), field
    assert declared.opt.density == 0
    assert declared.opt.viscosity == 0
    np.testing.assert_array_equal(declared.geom_friction[:, 0], 1.0)


@pytest.mark.parametrize("name", [n for n in NAMES if n not in UNPUBLISHED])
def test_published_scenes_are_the_declared_ones_with_effects(name):
    declared, published = model(name), model(name, "published")
    for field in ("jnt_type", "jnt_axis", "actuator_gainprm", "actuator_gear"):
        np.testing.assert_array_equal(getattr(declared, field), getattr(published, field))
    bodies = declared.nbody  # a payload comes after them
    for field in ("body_mass", "body_inertia", "body_ipos", "body_pos"):
        np.testing.assert_array_equal(getattr(declared, field), getattr(published, field)[:bodies])
    assert [declared.joint(i).name for i in range(declared.njnt)] == [
        published.joint(i).name for i in range(published.njnt)
    ]


@pytest.mark.parametrize("name", NAMES)
def test_every_scene_says_where_its_figures_come_from(name):
    text = (ASSETS / name / "README.md").read_text()
    assert "## Source" in text
    assert "github.com" in text
    assert "| figure |" in text


def test_kuka_stands_as_it_should():
    arm = model("kuka_kr300")
    data = mujoco.MjData(arm)
    data.qpos[:] = np.deg2rad([0, -90, 90, 0, 0, 0])
    mujoco.mj_forward(arm, data)
    shoulder, elbow, wrist = (data.body(f"link_{i}").xpos for i in (2, 3, 5))
    np.testing.assert_allclose(shoulder, [0.35, 0, 0.675], atol=1e-5)
    np.testing.assert_allclose(elbow - shoulder, [0, -0.189, 1.15], atol=1e-5)
    np.testing.assert_allclose(wrist[0] - elbow[0], 1.0, atol=1e-5)
    np.testing.assert_allclose(arm.dof_armature[0], 256.86**2 * 0.00923, rtol=1e-4)


def counterbalance(angle):
    """Torque on axis 2 by the published geometry of the gas spring, N*m."""
    delta, far, near = angle + np.deg2rad(95), 0.8, 0.2
    length = np.sqrt(far**2 + near**2 - 2 * far * near * np.cos(delta))
    area = np.pi / 4 * (0.055**2 - 0.030**2)
    volume = 0.96e-3 - (length - (far - near)) * area
    pressure = 1.01 * 296.8 * 328 * 0.159 / volume
    return far * near * np.sin(delta) / length * pressure * area


def test_kuka_counterbalance_is_the_published_one():
    arm = model("kuka_kr300", "published")
    data = mujoco.MjData(arm)
    for angle in np.linspace(-2.0, -1.05, 9):
        data.qpos[:] = 0
        data.qpos[1] = angle
        mujoco.mj_forward(arm, data)
        assert data.qfrc_passive[1] == pytest.approx(-counterbalance(angle), abs=5.0)


def test_ball_forces_are_those_of_the_literature():
    ball = model("table_tennis_ball", "published")
    data = mujoco.MjData(ball)
    data.qpos[2] = 1.0
    speed, spin, radius, density = 6.0, 100.0, 0.02, 1.2
    data.qvel[:] = (speed, 0, 0, 0, 0, spin)
    mujoco.mj_forward(ball, data)
    area = np.pi * radius**2
    drag = 0.5 * 0.45 * density * area * speed**2
    lift = 0.5 * 0.6 * (radius * spin / speed) * density * area * speed**2
    np.testing.assert_allclose(data.qfrc_passive[:3], [-drag, lift, 0], rtol=0.01, atol=1e-9)


def test_ball_bounces_like_a_table_tennis_ball():
    ball = model("table_tennis_ball", "published")
    ball.opt.density = ball.opt.viscosity = 0
    for speed in (1.0, 2.0, 4.0):
        data = mujoco.MjData(ball)
        data.qpos[2] = 0.1
        data.qvel[2] = -speed
        touched = False
        while data.time < 1.0 and not (touched and data.ncon == 0):
            mujoco.mj_step(ball, data)
            touched |= data.ncon > 0
        arrival = np.hypot(speed, np.sqrt(2 * 9.81 * 0.1))
        assert 0.85 < data.qvel[2] / arrival < 0.95
