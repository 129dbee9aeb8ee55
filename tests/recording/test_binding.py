"""Recordings put into a scene's order."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import Recording, load_scene
from orbisim.errors import RecordingError
from orbisim.recording import bind, capture
from orbisim.recording import quaternions as quat

from .scenes import ARM, EVERYTHING, PENDULUM, simulate

T = np.linspace(0, 1, 101)


@pytest.fixture(scope="module")
def pendulum():
    return load_scene(PENDULUM)


@pytest.fixture(scope="module")
def everything():
    return load_scene(EVERYTHING)


@pytest.fixture(scope="module")
def trajectory(everything):
    return simulate(everything, 400)


def refused(recording, scene, pattern):
    with pytest.raises(RecordingError, match=pattern) as caught:
        bind(recording, scene)
    assert "\n" not in str(caught.value)


def test_named_and_whole_signals_bind_to_the_same(everything, trajectory):
    named = capture(everything, trajectory)
    whole = Recording(
        named.time,
        {
            "qpos": trajectory.with_initial("qpos")[0],
            "qvel": trajectory.with_initial("qvel")[0],
            "ctrl": np.concatenate([trajectory.control[0], trajectory.control[0, -1:]]),
            "sensordata": np.concatenate([trajectory.sensordata[0], np.full((1, 4), np.nan)]),
        },
    )
    a, b = bind(named, everything), bind(whole, everything)
    for name in ("qpos", "qvel", "ctrl", "torque", "sensordata"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    assert a.measured == b.measured == frozenset(range(5))
    assert a.notes == b.notes == ()


@pytest.mark.parametrize(
    ("signals", "pattern"),
    [
        (
            {"qpos/hings": T},
            "'qpos/hings': scene 'pendulum' has no such joint.*did you mean 'hinge'",
        ),
        ({"qpos/hinge/0": T}, r"did you mean 'hinge'.*end in \[0\]"),
        ({"qpos/hinge": T, "ctrl/moter": T}, "no such actuator.*did you mean 'motor'"),
        ({"qpos/hinge": T, "xpos/hands": np.zeros((101, 3))}, "no such body.*did you mean 'hand'"),
        ({"qpos/hinge": T, "sensor/imu": T}, "no such sensor.*known: none"),
        ({"qpos": np.zeros((101, 3))}, "'qpos': has 3 columns; scene 'pendulum' needs 1"),
        ({"qpos/hinge": np.zeros((101, 2))}, "'qpos/hinge': has 2 columns; 'hinge' needs 1"),
        ({"qpos/hinge": T, "qpos": 2 * T}, "'qpos/hinge': differs from what 'qpos' holds"),
        ({"qvel/hinge": T}, "joint 'hinge' of scene 'pendulum' not recorded.*record 'qpos/hinge'"),
        (
            {"qpos/hinge": np.full(101, np.nan)},
            "joint 'hinge' of scene 'pendulum' not recorded.*'qpos/hinge' has no sample from 0 to "
            "1 s.*leave out the stretch",
        ),
    ],
)
def test_what_does_not_fit_is_refused(pendulum, signals, pattern):
    refused(Recording(T, signals), pendulum, pattern)


def test_one_sample_is_refused(pendulum):
    refused(Recording([0.0], {"qpos/hinge": [0.0]}), pendulum, "has one sample")


def test_stated_units_must_be_si(pendulum, everything):
    recording = Recording(T, {"qpos/hinge": T}, units={"qpos/hinge": "deg"})
    refused(recording, pendulum, "states the unit 'deg'; the scene needs 'rad'; convert")
    bind(recording.replace(units={"qpos/hinge": "radians"}), pendulum)
    rail = Recording(T, {"qpos/rail": T, "torque/rail": T}, units={"torque/rail": "Nm"})
    refused(rail, everything, "states the unit 'Nm'; the scene needs 'N'")


# -- orientations ----------------------------------------------------------------------------------


def cube_recording(everything, trajectory, **changes):
    recording = capture(everything, trajectory)
    return recording.replace(signals={**recording.signals, **changes})


def test_quaternions_have_unit_norm(everything, trajectory):
    pose = np.array(capture(everything, trajectory)["qpos/cube"])
    pose[7, 3:] *= 1.1
    refused(
        cube_recording(everything, trajectory, **{"qpos/cube": pose}),
        everything,
        "'qpos/cube': row 7 is not a unit quaternion: its norm is 1.1",
    )
    pose[7, 3:] = 0
    refused(cube_recording(everything, trajectory, **{"qpos/cube": pose}), everything, "norm is 0")
    pose[7, 3:] = np.nan
    pose[8:, 3:] *= -1.002
    bound = bind(cube_recording(everything, trajectory, **{"qpos/cube": pose}), everything)
    assert any("norms are up to 0.002 off one; scaled" in note for note in bound.notes)
    assert np.isnan(bound.qpos[7, 5:9]).all()
    assert np.nanmax(np.abs(np.linalg.norm(bound.qpos[:, 5:9], axis=1) - 1)) < 1e-12


def test_other_component_orders_are_found_by_the_angular_velocity(everything, trajectory):
    pose = np.array(capture(everything, trajectory)["qpos/cube"])
    swapped = np.concatenate([pose[:, :3], pose[:, 4:], pose[:, 3:4]], axis=1)
    refused(
        cube_recording(everything, trajectory, **{"qpos/cube": swapped}),
        everything,
        "read as x, y, z, w it does; record quaternions as w, x, y, z",
    )


def test_world_frame_angular_velocity_is_noticed(everything, trajectory):
    recording = capture(everything, trajectory)
    velocity = np.array(recording["qvel/cube"])
    velocity[:, 3:] = quat.rotate(recording["qpos/cube"][:, 3:], velocity[:, 3:])
    bound = bind(cube_recording(everything, trajectory, **{"qvel/cube": velocity}), everything)
    assert any("as a vector of the world frame" in note for note in bound.notes)


def test_nearly_upright_bodies_hint_at_the_order(everything, trajectory):
    still = capture(everything, trajectory).without("qpos/cube", "qvel/cube")
    count = len(still)
    poses = {
        "xpos/cube": np.zeros((count, 3)),
        "xquat/cube": np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
    }
    bound = bind(still.replace(signals={**still.signals, **poses}), everything)
    assert any("must be w, x, y, z" in note for note in bound.notes)


# -- what is inferred ------------------------------------------------------------------------------


def test_free_joints_from_the_pose_of_their_body(everything, trajectory):
    recording = capture(everything, trajectory, bodies=["cube"])
    expected = bind(recording, everything).qpos
    found = bind(recording.without("qpos/cube"), everything)
    np.testing.assert_allclose(found.qpos, expected, atol=1e-12)
    assert found.measured == frozenset(range(5))
    refused(
        recording.without("qpos/cube", "xquat/cube"),
        everything,
        "joint 'cube' of scene 'everything' not recorded.*or 'xpos/cube' and 'xquat/cube'",
    )


def test_a_ball_needs_no_orientation():
    scene = load_scene(
        "<mujoco><worldbody><body name='ball'><freejoint name='ball'/><geom size='.02'/></body>"
        "</worldbody></mujoco>"
    )
    bound = bind(Recording(T, {"xpos/ball": np.stack([T, T, T], 1)}), scene)
    np.testing.assert_array_equal(bound.qpos[:, 3:], np.tile([1.0, 0, 0, 0], (101, 1)))
    assert bound.unseen_turns == {0}
    assert any("it is a sphere" in note for note in bound.notes)


COUPLED = """
<mujoco model="gripper"><worldbody>
  <body name="left"><joint name="left" type="slide" axis="1 0 0"/><geom size=".1"/></body>
  <body name="right"><joint name="right" type="slide" axis="1 0 0"/><geom size=".1"/></body>
  <body name="third"><joint name="third" type="slide" axis="1 0 0"/><geom size=".1"/></body>
</worldbody><equality>
  <joint joint1="right" joint2="left" polycoef=".1 -2 0 0 0"/>
  <joint joint1="third" joint2="right" polycoef="0 0 1 0 0"/>
</equality></mujoco>
"""


def test_coupled_joints_follow():
    scene = load_scene(COUPLED)
    bound = bind(Recording(T, {"qpos/left": T}), scene)
    np.testing.assert_allclose(bound.qpos, np.stack([T, 0.1 - 2 * T, (0.1 - 2 * T) ** 2], 1))
    assert bound.measured == {0}
    assert "joint 'right' follows 'left' by a joint equality" in bound.notes
    back = bind(Recording(T, {"qpos/right": T, "qpos/third": T}), scene)
    np.testing.assert_allclose(back.qpos[:, 0], (T - 0.1) / -2)
    refused(Recording(T, {"qpos/third": T}), scene, "joints 'left', 'right'.*nothing.*fixes them")


@pytest.fixture(scope="module")
def arm():
    return load_scene(ARM)


def arm_motion(arm):
    trajectory = simulate(arm, 300, speed=3.0)
    return capture(arm, trajectory, bodies=["upper", "lower", "hand"])


def test_inverse_kinematics(arm):
    recording = arm_motion(arm)
    expected = bind(recording, arm).qpos
    for given in (
        ["xpos/lower", "xquat/hand"],
        ["xquat/upper", "xquat/hand"],
        ["xpos/lower", "xpos/hand"],
    ):
        bound = bind(recording.select(given), arm)
        np.testing.assert_allclose(bound.qpos, expected, atol=1e-5)
        assert any("by inverse kinematics" in note for note in bound.notes)
    one = bind(recording.select(["qpos/shoulder", "xquat/hand"]), arm)
    np.testing.assert_allclose(one.qpos, expected, atol=1e-5)


def test_inverse_kinematics_that_is_not_unique(arm):
    recording = arm_motion(arm)
    refused(
        recording.select(["xpos/hand"]), arm, "'shoulder', 'elbow'.*fit more than one configuration"
    )
    refused(
        recording.select(["xpos/lower"]), arm, "joint 'elbow'.*nothing that is recorded fixes it"
    )


def test_inverse_kinematics_of_a_ball_joint(everything, trajectory):
    recording = capture(everything, trajectory, bodies=["bob"])
    expected = bind(recording, everything).qpos
    bound = bind(recording.without("qpos/socket"), everything)
    np.testing.assert_allclose(bound.qpos, expected, atol=1e-6)


def test_inverse_kinematics_passes_over_missing_rows(arm):
    recording = arm_motion(arm)
    position = np.array(recording["xpos/lower"])
    position[10:13] = np.nan
    partial = recording.replace(
        signals={"xpos/lower": position, "xquat/hand": recording["xquat/hand"]}
    )
    bound = bind(partial, arm)
    assert np.isnan(bound.qpos[10:13]).all()
    assert np.isfinite(bound.qpos[13:]).all()


# -- what drives the scene -------------------------------------------------------------------------


def test_missing_controls_hold(pendulum):
    ctrl = np.array([np.nan, 0.5, np.nan, np.nan, 0.2])
    bound = bind(
        Recording(np.arange(5.0), {"qpos/hinge": np.zeros(5), "ctrl/motor": ctrl}), pendulum
    )
    np.testing.assert_array_equal(bound.ctrl[:, 0], [0.5, 0.5, 0.5, 0.5, 0.2])
    assert "missing controls hold the sample before them" in bound.notes


def test_absent_controls_are_zero_with_a_note(pendulum):
    bound = bind(Recording(T, {"qpos/hinge": T}), pendulum)
    assert not bound.ctrl.any()
    assert "controls of 'motor' are not recorded; taken as zero" in bound.notes


def test_torques_drive_unless_controls_are_recorded(pendulum):
    driven = bind(Recording(T, {"qpos/hinge": T, "torque/hinge": T}), pendulum)
    assert driven.applied.all()
    assert driven.switched_off == (0,)
    assert any("'torque/hinge' stands for 'motor'" in note for note in driven.notes)
    both = bind(Recording(T, {"qpos/hinge": T, "torque/hinge": T, "ctrl/motor": T}), pendulum)
    assert not both.applied.any()
    assert both.switched_off == ()


def test_friction_actuators_stay_on():
    scene = load_scene(
        "<mujoco><worldbody><body><joint name='j'/><geom size='.1'/></body></worldbody><actuator>"
        "<dcmotor name='friction' joint='j' motorconst='1e-9' resistance='1' input='none'/>"
        "<motor name='motor' joint='j'/></actuator></mujoco>"
    )
    bound = bind(Recording(T, {"qpos/j": T, "torque/j": T}), scene)
    assert bound.switched_off == (1,)
    bound = bind(Recording(T, {"qpos/j": T, "ctrl/motor": 2 * T}), scene)
    np.testing.assert_array_equal(bound.ctrl[:, 0], 2 * T)


# -- what looks wrong ------------------------------------------------------------------------------


def notes(scene, **signals):
    signals = {name.replace("__", "/"): values for name, values in signals.items()}
    return " | ".join(bind(Recording(T, signals), scene).notes)


def test_degrees_are_noticed(pendulum):
    swing = 1.5 * np.sin(5 * T)
    rate = 7.5 * np.cos(5 * T)
    fine = notes(pendulum, qpos__hinge=swing, qvel__hinge=rate, ctrl__motor=0 * T)
    assert fine == ""
    assert "are these degrees?" in notes(pendulum, qpos__hinge=np.rad2deg(swing))
    assert "joint's range is -2 to 2" in notes(pendulum, qpos__hinge=2 * swing)
    assert "degrees?" not in notes(pendulum, qpos__hinge=2 * swing)
    both = notes(pendulum, qpos__hinge=swing, qvel__hinge=np.rad2deg(rate))
    assert "57.3 times the derivative of 'qpos/hinge'; are they in degrees per second?" in both
    assert "are the positions in degrees?" in notes(
        pendulum, qpos__hinge=np.rad2deg(swing), qvel__hinge=rate
    )


def test_velocities_that_are_not_the_derivative(pendulum):
    swing, rate = np.sin(5 * T), 5 * np.cos(5 * T)
    assert "sign reversed" in notes(pendulum, qpos__hinge=swing, qvel__hinge=-rate)
    assert "2 times the derivative" in notes(pendulum, qpos__hinge=swing, qvel__hinge=2 * rate)
    assert "stays zero although" in notes(pendulum, qpos__hinge=swing, qvel__hinge=0 * T)
    noise = np.random.default_rng(0).standard_normal(101)
    assert "derivative" not in notes(pendulum, qpos__hinge=swing, qvel__hinge=rate + noise)
    assert "derivative" not in notes(pendulum, qpos__hinge=0 * T, qvel__hinge=0.01 * noise)


def test_controls_beyond_their_range(pendulum):
    found = notes(pendulum, qpos__hinge=T, ctrl__motor=4 * T - 2)
    assert "goes from -2 to 2, beyond the actuator's range -1 to 1 in 49.5% of the samples" in found


def test_constant_signals_are_fine(pendulum):
    assert notes(pendulum, qpos__hinge=0 * T, qvel__hinge=0 * T, ctrl__motor=0 * T) == ""
