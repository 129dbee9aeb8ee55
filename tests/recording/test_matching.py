"""Columns and the signals that they may be."""

from __future__ import annotations

import pytest

from orbisim import load_scene
from orbisim.recording.formats.log import Column
from orbisim.recording.matching import Target, likeness, matches

from .scenes import EVERYTHING, PENDULUM

NAMED = {
    "elbow_pos [deg]": "qpos/elbow",
    "ShoulderPosition": "qpos/shoulder",
    "elbow_velocity (rpm)": "qvel/elbow",
    "tau_shoulder [mNm]": "torque/shoulder",
    "cmd_elbow": "ctrl/elbow",
    "shoulder_u [mNm]": "ctrl/shoulder",
    "rail_mm": "qpos/rail",
    "cube_x": "xpos/cube/x",
    "encoder": "sensor/encoder",
}


def test_columns_are_matched_by_name_and_unit() -> None:
    model = load_scene(EVERYTHING).model
    found = matches([Column(name) for name in ("t", *NAMED, "battery")], model, table=True)
    assert {match.column.name: match.signal for match in found} == NAMED


def test_the_only_ones_of_their_kind() -> None:
    model = load_scene(PENDULUM).model
    columns = ["timestamp [ms]", "yaw_pos [deg]", "yaw_cmd [mNm]", "temp"]
    found = {m.column.name: m for m in matches(map(Column, columns), model)}
    assert found["yaw_pos [deg]"].signal == "qpos/hinge"
    assert found["yaw_cmd [mNm]"].signal == "ctrl/motor"
    assert all(match.why for match in found.values())
    assert len(found) == 2


def test_numbered_columns_are_in_the_scenes_order() -> None:
    model = load_scene(EVERYTHING).model
    found = matches([Column(f"u{i}") for i in (2, 1)], model)
    assert {m.column.name: m.signal for m in found} == {"u1": "ctrl/shoulder", "u2": "ctrl/elbow"}
    assert not matches([Column(f"u{i}") for i in (1, 2, 3)], model)


def test_a_number_alone_is_no_name() -> None:
    assert likeness(Column("state[1]"), Target("qpos/joint1", 1)) == 0.0
    assert likeness(Column("joint1_pos"), Target("qpos/joint1", 1)) == 1.0


def test_widths_and_what_the_format_says() -> None:
    model = load_scene(EVERYTHING).model
    columns = [
        Column("/imu/linear_acceleration", (9, 3), "m/s^2"),
        Column("/a", (9,), signal="qpos/rail"),
    ]
    found = {m.column.name: m.signal for m in matches(columns, model)}
    assert found["/a"] == "qpos/rail"
    assert found["/imu/linear_acceleration"] == "sensor/imu"


@pytest.mark.parametrize("unit", ["N", "m/s", "V"])
def test_units_that_do_not_fit_are_no_match(unit: str) -> None:
    assert likeness(Column(f"elbow_pos [{unit}]"), Target("qpos/elbow", 1, "rad")) == 0.0
