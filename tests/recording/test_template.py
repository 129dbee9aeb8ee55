"""First maps."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from orbisim import Recording, load_scene
from orbisim.recording import bind
from orbisim.recording.files import opened
from orbisim.recording.mapping import SignalMap
from orbisim.recording.template import propose

from .scenes import EVERYTHING, PENDULUM


def write(path: Path, **datasets: object) -> Path:
    with h5py.File(path, "w") as file:
        for name, values in datasets.items():
            file[name] = values
    return path


def test_whole_vectors_and_units(tmp_path: Path) -> None:
    time = np.arange(0, 1, 0.1)
    pose = np.stack([time, time, time], axis=1)
    log = write(tmp_path / "a.h5", time=time, cube_position=pose, elbow_deg=time, state=pose[:, :2])
    found = propose(opened(log), load_scene(EVERYTHING))
    assert found.matched["cube_position"] == "xpos/cube"
    assert "cube_position: {signal: xpos/cube, unit: m" in found.text
    assert "elbow_deg: {signal: qpos/elbow, unit: deg" in found.text
    assert "#   qpos/shoulder" in found.text
    (tmp_path / "map.yaml").write_text(found.text)
    recording = Recording.load(log, tmp_path / "map.yaml")
    np.testing.assert_allclose(recording["qpos/elbow"], np.radians(time))
    np.testing.assert_array_equal(recording["xpos/cube"], pose)


@pytest.mark.parametrize("name", ['a"b', "a: b", "ö [deg]", "null", "- a", "#a", "a\tb", "*x"])
def test_odd_names_stand_in_a_map(tmp_path: Path, name: str) -> None:
    columns = f"{name} hinge position"
    log = write(tmp_path / "a.h5", time=[0.0, 1.0], **{columns: [1.0, 2.0]})
    found = propose(opened(log), load_scene(PENDULUM))
    (tmp_path / "map.yaml").write_text(found.text, encoding="utf-8")
    entries = SignalMap.load(tmp_path / "map.yaml").entries
    assert {e.column: e.signal for e in entries} == {"time": "time", columns: "qpos/hinge"}


def test_nothing_that_is_like_a_signal(tmp_path: Path) -> None:
    found = propose(opened(write(tmp_path / "a.h5", time=[0.0], xyz=[1.0])), load_scene(PENDULUM))
    assert found.unmatched == ("xyz",)
    assert "# Positions that the scene needs" in found.text


def test_forces_are_proposed_but_not_taken(tmp_path: Path) -> None:
    log = write(tmp_path / "a.h5", time=[0.0], hinge_pos=[1.0], hinge_effort=[0.0])
    found = propose(opened(log), load_scene(PENDULUM))
    assert found.matched == {"hinge_pos": "qpos/hinge"}
    assert "  # hinge_effort: {signal: torque/hinge" in found.text


def test_an_actuator_without_a_name_is_said_to_need_one(tmp_path: Path) -> None:
    motor = '<actuator><motor joint="hinge"/></actuator></mujoco>'
    bare = """<mujoco><worldbody><body><joint name="hinge"/><geom size="1"/></body></worldbody>"""
    time = np.arange(0, 1, 0.01)
    log = write(tmp_path / "a.h5", time=time, hinge_pos=np.sin(time), hinge_cmd=time)
    scene = load_scene(bare + motor)
    found = propose(opened(log), scene)
    assert "  #   #0 at joint hinge" in found.text
    (tmp_path / "map.yaml").write_text(found.text)
    bound = bind(Recording.load(log, tmp_path / "map.yaml"), scene)
    assert any("needs a name in the scene" in note for note in bound.notes)
    named = propose(opened(log), load_scene(bare + motor.replace("joint", "name='m' joint")))
    assert "without a name" not in named.text
