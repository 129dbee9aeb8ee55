"""Headers with units in them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbisim.recording import names, units
from orbisim.recording.formats.labels import Label, escaped, is_time, parse

from ..test_names import signals

HEADERS = {
    "yaw_pos [deg]": ("yaw_pos", "deg"),
    "yaw[deg]": ("yaw", "deg"),
    " speed (rpm)": ("speed", "rpm"),
    "Time (s)": ("Time", "s"),
    "timestamp [ms]": ("timestamp", "ms"),
    "time_us": ("time", "us"),
    "t_s": ("t", "s"),
    "yaw_deg": ("yaw", "deg"),
    "wheel_deg_s": ("wheel", "deg/s"),
    "wheel_rpm": ("wheel", "rpm"),
    "cmd_mNm": ("cmd", "mNm"),
    "qpos/yaw [deg]": ("qpos/yaw", "deg"),
    "xpos/cube/x [mm]": ("xpos/cube/x", "mm"),
    "qpos/ball[3]": ("qpos/ball[3]", None),
    "qpos[0] [deg]": ("qpos[0]", "deg"),
    "qpos/arm [left]": ("qpos/arm [left]", None),
    "qpos/arm_deg": ("qpos/arm_deg", None),
    "left_s": ("left_s", None),
    "motor_A": ("motor_A", None),
    "[deg]": ("[deg]", None),
    "_deg": ("_deg", None),
    "qpos/arm [deg] [SI]": ("qpos/arm [deg]", "SI"),
    "": ("", None),
}


@pytest.mark.parametrize("header", HEADERS)
def test_headers(header: str) -> None:
    assert parse(header) == Label(*HEADERS[header])


@pytest.mark.parametrize("name", ["time", "Timestamp", "t", "stamp", "imu/time", "elapsed_time"])
def test_names_of_time(name: str) -> None:
    assert is_time(name)


@pytest.mark.parametrize("name", ["temperature", "times", "theta", "T1", ""])
def test_other_names(name: str) -> None:
    assert not is_time(name)


@given(st.text(max_size=40))
def test_any_text_is_a_header(header: str) -> None:
    label = parse(header)
    assert label.unit is None or units.known(label.unit)
    assert parse(escaped(header.lstrip())).name == header.lstrip()


@given(signals)
def test_signals_keep_their_names(signal: tuple[str, int | None]) -> None:
    for column in names.columns(*signal):
        label = parse(escaped(column))
        assert (label.name, label.unit) in ((column, None), (column, units.AS_IT_IS))


@given(
    st.text(st.characters(exclude_characters="[]()/", exclude_categories=("C", "Z")), min_size=1),
    st.sampled_from(["deg", "mNm", "ms", "rad/s", "m/s^2", "rpm"]),
    st.sampled_from([" [{}]", "[{}]", " ({})", "  [ {} ]"]),
)
def test_units_come_out_of_brackets(name: str, unit: str, form: str) -> None:
    assert parse(name + form.format(unit)) == Label(name.lstrip(), unit)
