"""Angles in degrees that are called radians are noticed, wheels and servos are told apart."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import orbisim
from orbisim import Recording, load_scene
from orbisim.cli.main import run
from orbisim.recording.actuators import actuators
from orbisim.recording.degrees import commands_angle, suspect
from orbisim.recording.files import opened
from orbisim.recording.joints import joints
from orbisim.recording.template import propose

from .scenes import EVERYTHING, PENDULUM

SWING = "<mujoco><worldbody><body><joint name='swing' axis='0 1 0'/>"
SWING += "<geom type='capsule' fromto='0 0 0 0 0 -.4' size='.02'/></body></worldbody></mujoco>"
TIME = np.arange(0, 2, 0.01)


def test_what_is_suspected() -> None:
    model = load_scene(EVERYTHING).model
    named = {joint.name: joint for joint in joints(model)}
    assert suspect([0.0, 80.0, np.nan], named["elbow"], model)
    assert not suspect([0.0, 3.0], named["elbow"], model)
    assert not suspect([0.0, 80.0], named["rail"], model)  # metres
    assert not suspect([np.nan], named["elbow"], model)
    turns = load_scene(SWING.replace("axis", "limited='true' range='-36000 36000' axis")).model
    assert not suspect([80.0], joints(turns)[0], turns)  # the scene says that it turns so far


def test_servos_are_commanded_angles() -> None:
    model = load_scene(EVERYTHING).model
    assert {one.name: commands_angle(one, model) for one in actuators(model)} == {
        "shoulder": False,
        "elbow": True,
    }


def test_a_first_map_says_degrees_where_radians_would_be_turns(tmp_path: Path) -> None:
    frame = pd.DataFrame({"time": TIME, "elbow_pos": 80 * np.sin(TIME), "rail_pos": 40 * TIME})
    frame["elbow_cmd"], frame["shoulder_pos"] = 90 * np.cos(TIME), np.sin(TIME)
    frame.to_csv(tmp_path / "log.csv", index=False)
    text = propose(opened(tmp_path / "log.csv"), load_scene(EVERYTHING)).text
    assert "elbow_pos: {signal: qpos/elbow, unit: deg," in text
    assert "elbow_cmd: {signal: ctrl/elbow, unit: deg," in text
    assert "shoulder_pos: {signal: qpos/shoulder, unit: rad," in text
    assert "rail_pos: {signal: qpos/rail, unit: m," in text


def test_a_command_is_a_control_though_it_is_a_torque(tmp_path: Path) -> None:
    frame = pd.DataFrame({"time": TIME, "hinge.pos": np.sin(TIME), "action/hinge.torque": TIME})
    frame.to_csv(tmp_path / "log.csv", index=False)
    scene = load_scene(PENDULUM.replace('name="motor"', 'name="hinge"'))
    matched = propose(opened(tmp_path / "log.csv"), scene).matched
    assert matched == {"hinge.pos": "qpos/hinge", "action/hinge.torque": "ctrl/hinge"}


def test_replay_asks_whether_they_are_degrees(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    still = {"qpos/swing": np.degrees(np.sin(5 * TIME))}
    result = orbisim.replay(SWING, Recording(time=TIME, signals=still))
    assert any("are these degrees?" in note for note in result.notes)
    model = load_scene(SWING)
    backend = orbisim.make_backend("mujoco", model)
    start = backend.reset()
    start = start.replace(qvel=np.full((1, 1), 40.0))  # a wheel's speed, that the scene explains
    wheel = backend.rollout(start, np.zeros((1, 1000, 0)))
    turned = Recording(time=wheel.time[0], signals={"qpos/swing": wheel.qpos[0, :, 0]})
    assert np.ptp(wheel.qpos[0]) > 40
    assert not any("degrees" in note for note in orbisim.replay(model, turned).notes)
    np.savez(tmp_path / "r.npz", time=TIME, **still)
    (tmp_path / "s.xml").write_text(SWING)
    assert run(["replay", str(tmp_path / "s.xml"), str(tmp_path / "r.npz"), "--json"]) == 0
    told = capsys.readouterr()
    assert "qpos/swing [deg]" in told.err
    assert json.loads(told.out)["overall"]["rms"] is None or json.loads(told.out)["windows"]
