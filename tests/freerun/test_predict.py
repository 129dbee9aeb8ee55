"""What a simulated run has to say about each measured signal, against MuJoCo itself."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from orbisim import Recording, Scene, load_scene, make_backend
from orbisim.freerun import Run
from orbisim.freerun.predict import predict
from orbisim.freerun.run import free_run
from orbisim.recording import bind
from orbisim.recording.observed import Signal
from orbisim.replay import prepare

SCENE = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="arm" pos="0 0 1">
      <joint name="elbow" axis="0 1 0" damping=".1"/>
      <geom type="capsule" fromto="0 0 0 .4 0 0" size=".03"/>
      <body name="hand" pos=".4 0 0"><geom size=".04"/><site name="tip"/></body>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="elbow" kp="5"/></actuator>
  <sensor>
    <jointvel name="spin" joint="elbow"/><accelerometer name="imu" site="tip"/>
    SENSORS
  </sensor>
</mujoco>
"""
LATE = '<jointpos name="late" joint="elbow" delay="0.03" nsample="8" interp="zoh"/>'


def run_of(scene: Scene) -> tuple[Run, object]:
    """Ten samples of the arm falling while its servo pulls."""
    time = 0.01 * np.arange(10)
    recording = Recording(
        time,
        {
            "qpos/elbow": np.zeros(10),
            "qvel/elbow": np.full(10, 0.5),
            "ctrl/servo": np.full(10, 0.7),
        },
    )
    bound = bind(recording, scene)
    return free_run(make_backend("mujoco", scene), scene, [prepare(bound, 0)])[0], bound


def reference(scene: Scene, run: Run) -> mujoco.MjData:
    """MuJoCo's own numbers at the last sample."""
    data = mujoco.MjData(scene.model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = run.qpos[-1], run.qvel[-1], 0.7
    mujoco.mj_forward(scene.model, data)
    return data


@pytest.mark.parametrize(
    ("home", "where", "of"),
    [
        ("qpos", slice(0, 1), lambda d: d.qpos[:1]),
        ("qvel", slice(0, 1), lambda d: d.qvel[:1]),
        ("torque", slice(0, 1), lambda d: d.qfrc_actuator[:1]),
        ("xpos", 2, lambda d: d.xpos[2]),
        ("xquat", 2, lambda d: d.xquat[2]),
        ("sensordata", slice(0, 1), lambda d: d.sensordata[:1]),
    ],
)
def test_signals_are_mujocos_own_numbers(home, where, of) -> None:
    scene = load_scene(SCENE.replace("SENSORS", ""))
    run, bound = run_of(scene)
    (found,) = predict(bound, [Signal("s", "1", home, where)], run)
    assert len(found) == 10
    np.testing.assert_allclose(found[-1], of(reference(scene, run)), rtol=1e-12, atol=1e-12)
    assert np.ptp(found, axis=0).max() > 0


def test_accelerations_are_not_made_up() -> None:
    """Of a run without sensor data: what the velocity stage cannot tell is not a number."""
    run, bound = run_of(load_scene(SCENE.replace("SENSORS", "")))
    assert run.sensordata is None
    (imu,) = predict(bound, [Signal("imu", "1", "sensordata", slice(1, 4))], run)
    assert np.isnan(imu).all()


def test_lost_samples_are_not_numbers() -> None:
    run, bound = run_of(load_scene(SCENE.replace("SENSORS", "")))
    qpos = run.qpos.copy()
    qpos[6:] = np.nan
    lost = dataclasses.replace(run, qpos=qpos, diverged=True)
    (found,) = predict(bound, [Signal("hand", "m", "xpos", 2)], lost)
    assert np.isnan(found).any(axis=1).tolist() == [False] * 6 + [True] * 4


def test_a_late_sensor_says_nothing_of_the_time_before_the_window() -> None:
    scene = load_scene(SCENE.replace("SENSORS", LATE))
    run, bound = run_of(scene)
    sensors = np.tile(np.arange(5.0), (10, 1))
    reported = dataclasses.replace(run, sensordata=sensors)
    (found,) = predict(bound, [Signal("late", "rad", "sensordata", slice(4, 5))], reported)
    assert np.isnan(found[:, 0]).tolist() == [True] * 4 + [False] * 6  # 0.03 s and one timestep
    (spin,) = predict(bound, [Signal("spin", "rad/s", "sensordata", slice(0, 1))], reported)
    assert np.isfinite(spin).all()
