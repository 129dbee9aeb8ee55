"""Controls of servos from their motion: what a simulation was given comes out again."""

from __future__ import annotations

import mujoco
import numpy as np

from orbisim.recording import Recording
from orbisim.recording.servo import with_controls

ARM = """
<mujoco>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" damping="1" armature="0.1"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="2"/>
      <body name="lower" pos="0.3 0 0">
        <joint name="elbow" axis="0 1 0" damping="1" armature="0.1"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="400" kv="40" ctrlrange="-2 2"/>
    <position name="elbow" joint="elbow" kp="200" kv="20"/>
    <motor name="extra" joint="elbow"/>
  </actuator>
</mujoco>
"""


def moved() -> tuple[mujoco.MjModel, Recording, np.ndarray]:
    """An arm that follows slow commands, seen 30 times a second."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data, every = mujoco.MjData(model), 1 / 30
    times, positions, controls = [], [], []
    for t in range(60):
        wanted = 0.5 * np.sin(3.0 * t * every), 0.4 * np.cos(2.0 * t * every)
        data.ctrl[:2] = wanted
        times.append(data.time)
        positions.append(data.qpos.copy())
        controls.append(wanted)
        while data.time < (t + 1) * every - 1e-9:
            mujoco.mj_step(model, data)
    qpos = np.array(positions)
    signals = {"qpos/shoulder": qpos[:, 0], "qpos/elbow": qpos[:, 1]}
    return model, Recording(np.array(times), signals), np.array(controls)


def test_what_wanders_within_the_stated_noise_is_no_command() -> None:
    """Errors that are alike from frame to frame look like motion to the samples alone."""
    model, recording, controls = moved()
    signals = dict(recording.signals)
    wander = 0.01 * np.sin(2.0 * np.pi * np.arange(60) / 9)
    signals["qpos/elbow"] = signals["qpos/elbow"] + wander
    inner, off = slice(8, -3), []
    for noise in ({}, {"qpos/elbow": 0.008}):
        seen = Recording(recording.time, signals, metadata={"noise": noise})
        found = np.asarray(with_controls(seen, model).signals["ctrl/elbow"])
        off.append(float(np.sqrt(np.mean((found - controls[:, 1])[inner] ** 2))))
    assert off[0] > 0.01  # the servo would have to follow
    assert off[1] < 0.5 * off[0]


def test_controls_of_servos_are_those_that_were_given() -> None:
    model, recording, controls = moved()
    found = with_controls(recording, model)
    for i, name in enumerate(("shoulder", "elbow")):
        inner = slice(8, -3)  # the start is a jump, and splines end
        error = np.asarray(found.signals[f"ctrl/{name}"])[inner] - controls[inner, i]
        lag = np.asarray(recording.signals[f"qpos/{name}"])[inner] - controls[inner, i]
        assert np.sqrt(np.mean(error**2)) < 0.02
        assert np.sqrt(np.mean(error**2)) < 0.3 * np.sqrt(np.mean(lag**2))
    assert "ctrl/extra" not in found.signals
    assert any("extra" in note and "no servos" in note for note in found.notes)


def test_nothing_is_made_up() -> None:
    model, recording, controls = moved()
    known = recording.replace(
        signals={
            **recording.signals,
            "ctrl/shoulder": controls[:, 0],
            "ctrl/elbow": controls[:, 1],
        }
    )
    assert with_controls(known, model) is known
    half = recording.replace(signals={"qpos/elbow": recording.signals["qpos/elbow"]})
    assert with_controls(half, model) is half
