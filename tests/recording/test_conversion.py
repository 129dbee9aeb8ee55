"""From logs as people have them to recordings in SI."""

from __future__ import annotations

import pickle
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from orbisim import Recording
from orbisim.errors import RecordingError
from orbisim.recording.recording import common_map

pd = pytest.importorskip("pandas")

quick = settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
TIMES = np.arange(5) * 10
ANGLES = np.array([0.0, 30.0, 45.0, -90.0, 180.0])
FRAME = pd.DataFrame(
    {
        "timestamp [ms]": TIMES,
        "yaw_pos [deg]": ANGLES,
        "yaw_cmd [mNm]": 100.0 * np.arange(5),
        "label": list("abcde"),
    }
)
MAP = """
columns:
  "timestamp [ms]": time
  "yaw_pos [deg]": {signal: qpos/yaw, sign: -1, offset: 45}
  "yaw_cmd [mNm]": ctrl/motor
"""


def write(frame: pd.DataFrame, path: Path) -> Path:
    if path.suffix == ".csv":
        frame.to_csv(path, index=False)
    elif path.suffix == ".parquet":
        frame.to_parquet(path)
    else:
        with h5py.File(path, "w") as file:
            for name in frame.columns:
                values = frame[name].to_numpy()
                file[name] = values.astype("S1") if values.dtype.kind == "O" else values
    return path


def mapped(folder: Path, path: Path, text: str) -> Recording:
    (folder / "map.yaml").write_text(text)
    return Recording.load(path, folder / "map.yaml")


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".h5"])
def test_degrees_and_milliseconds_by_a_map(tmp_path: Path, suffix: str) -> None:
    path = write(FRAME, tmp_path / f"log{suffix}")
    recording = mapped(tmp_path, path, MAP)
    np.testing.assert_array_equal(recording.time, [0, 0.01, 0.02, 0.03, 0.04])
    np.testing.assert_allclose(recording["qpos/yaw"], np.radians(45 - ANGLES), rtol=1e-15)
    np.testing.assert_allclose(recording["ctrl/motor"], [0, 0.1, 0.2, 0.3, 0.4])
    assert dict(recording.units) == {"qpos/yaw": "rad", "ctrl/motor": "N*m"}
    assert recording.columns == ("label",)
    assert recording.notes == ()
    assert recording.map_file == str(tmp_path / "map.yaml")
    later = pickle.loads(pickle.dumps(recording)).between(0.01, 0.03)
    assert common_map([recording, later]) == recording.map_file
    assert common_map([recording, later.replace(map_file=None)]) is None


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_signals_with_units_need_no_map(tmp_path: Path, suffix: str) -> None:
    frame = pd.DataFrame(
        {
            "time [us]": [0, 1000],
            "qpos/yaw [deg]": [0.0, 180.0],
            "xpos/cube/x [mm]": [1.0, 2.0],
            "xpos/cube/y [mm]": [1.0, 2.0],
            "xpos/cube/z [mm]": [1.0, 2.0],
            "qvel/yaw (rpm)": [0.0, 60.0],
        }
    )
    recording = Recording.load(write(frame, tmp_path / f"log{suffix}"))
    np.testing.assert_array_equal(recording.time, [0, 1e-3])
    np.testing.assert_allclose(recording["qpos/yaw"], [0, np.pi])
    np.testing.assert_allclose(recording["qvel/yaw"], [0, 2 * np.pi])
    np.testing.assert_allclose(recording["xpos/cube"], [[1e-3] * 3, [2e-3] * 3])
    assert recording.units["xpos/cube"] == "m"


@quick
@given(
    st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=6),
    st.sampled_from([("deg", np.pi / 180), ("mm", 1e-3), ("rpm", np.pi / 30), ("kN", 1e3)]),
    st.sampled_from([("ms", 1e3), ("us", 1e6), ("ns", 1e9), ("s", 1.0)]),
    st.sampled_from([".csv", ".parquet"]),
)
def test_what_is_written_in_a_unit_comes_back_in_si(tmp_path, values, unit, clock, suffix):
    frame = pd.DataFrame(
        {
            f"time [{clock[0]}]": np.arange(len(values)) * clock[1] * 0.01,
            f"ctrl/a [{unit[0]}]": np.array(values) / unit[1],
        }
    )
    recording = Recording.load(write(frame, tmp_path / f"log{suffix}"))
    np.testing.assert_allclose(recording.time, 0.01 * np.arange(len(values)), atol=1e-15)
    np.testing.assert_allclose(recording["ctrl/a"], values, rtol=1e-12, atol=1e-300)


def test_nanoseconds_since_1970_keep_their_digits(tmp_path: Path) -> None:
    start = 1_700_000_000_123_456_789
    frame = pd.DataFrame({"time [ns]": start + np.arange(4) * 1_000_001, "ctrl/a": range(4)})
    for suffix in (".csv", ".parquet"):
        recording = Recording.load(write(frame, tmp_path / f"log{suffix}"))
        np.testing.assert_array_equal(recording.time, np.arange(4) * 1_000_001 / 1e9)
        assert "time counts from the first sample, 1700000000.123457 s" in recording.notes[0]


def test_moments_are_times(tmp_path: Path) -> None:
    stamps = pd.date_range("2024-05-01 12:00:00.5", periods=3, freq="5ms")
    frame = pd.DataFrame({"timestamp": stamps, "ctrl/a": range(3)})
    for suffix in (".csv", ".parquet"):
        recording = Recording.load(write(frame, tmp_path / f"log{suffix}"))
        np.testing.assert_allclose(recording.time, [0, 0.005, 0.01])


@pytest.mark.parametrize(("comma", "point"), [(";", ","), (";", "."), ("\t", ".")])
def test_other_separators(tmp_path: Path, comma: str, point: str) -> None:
    path = tmp_path / "log.csv"
    frame = pd.DataFrame({"time": [0.5, 1.5], "qpos/a": [0.25, -1.75]})
    frame.to_csv(path, index=False, sep=comma, decimal=point)
    recording = Recording.load(path)
    np.testing.assert_array_equal(recording.time, [0.5, 1.5])
    np.testing.assert_array_equal(recording["qpos/a"], [0.25, -1.75])


def test_a_time_of_another_name_is_said(tmp_path: Path) -> None:
    path = write(pd.DataFrame({"t": [0.0, 1.0], "ctrl/a": [1, 2]}), tmp_path / "a.csv")
    recording = Recording.load(path)
    assert recording.notes == ("'t' is taken as the time in seconds, as it names no unit",)


def test_components_by_a_map(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["t"] = [0.0, 0.1]
        file["pose"] = [[1.0, 2, 3, 0.5, 0.5, 0.5, -0.5]] * 2
    entries = {f"pose[{i}]": f"xpos/c/{axis}" for i, axis in enumerate("xyz")}
    entries |= {
        f"pose[{i}]": f"xquat/c/{axis}" for i, axis in zip((3, 4, 5, 6), "xyzw", strict=True)
    }
    text = "columns:\n" + "".join(f'  "{k}": {v}\n' for k, v in {"t": "time", **entries}.items())
    recording = mapped(tmp_path, tmp_path / "log.h5", text)
    np.testing.assert_array_equal(recording["xpos/c"][0], [1, 2, 3])
    np.testing.assert_array_equal(recording["xquat/c"][0], [-0.5, 0.5, 0.5, 0.5])


def test_groups_of_hdf5_keep_their_clocks(tmp_path: Path) -> None:
    fast, slow = np.arange(0, 1.0, 0.005), np.arange(0.1, 0.8, 0.02)
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["joints/time"] = slow
        file["joints/yaw"] = np.degrees(np.sin(slow))
        file["joints/yaw"].attrs["units"] = "deg"
        file["imu/time_ms"] = fast * 1e3
        file["imu/gyro"] = np.stack([fast, 2 * fast, 3 * fast], axis=1)
        file["drive/time"] = [0.2, 0.5]
        file["drive/u"] = [1.0, 2.0]
    text = "columns: {joints/yaw: qpos/yaw, imu/gyro: sensor/gyro, drive/u: ctrl/motor}"
    recording = mapped(tmp_path, tmp_path / "log.h5", text)
    np.testing.assert_array_equal(recording.time, slow)
    np.testing.assert_allclose(recording["qpos/yaw"], np.sin(slow))
    np.testing.assert_allclose(recording["sensor/gyro"][:, 2], 3 * slow)
    expected = np.where(slow < 0.2 - 1e-12, np.nan, np.where(slow < 0.5 - 1e-12, 1.0, 2.0))
    np.testing.assert_array_equal(recording["ctrl/motor"], expected)
    assert any("'sensor/gyro' were sampled at 200 Hz" in note for note in recording.notes)
    other = mapped(tmp_path, tmp_path / "log.h5", text + "\nclock: imu/gyro")
    np.testing.assert_allclose(other.time, fast)
    assert np.isnan(other["qpos/yaw"][[0, -1]]).all()


WRONG = {
    'columns: {"yaw [deg]": qpos/yaw}': "has no such column: unknown column 'yaw \\[deg\\]'",
    'columns: {"timestamp [ms]": time, label: qpos/yaw}': "label",
    'columns: {"timestamp [ms]": time, "yaw_pos [deg]": xpos/a}': "is a vector; its columns are",
    'columns: {"yaw_pos [deg]": time}': "'deg' is no unit of time",
    'columns: {"yaw_pos [deg]": qpos/a, "yaw_cmd [mNm]": qpos/a}': "are both 'qpos/a'",
    'columns: {"timestamp [ms]": time, "yaw_pos [deg]": time}': "are both 'time'",
    'columns: {"yaw_pos [deg]": "qpos[0]", "yaw_cmd [mNm]": "qpos[1]"}': "units N\\*m and rad",
    'clock: label\ncolumns: {"yaw_pos [deg]": qpos/a}': "'clock': must name a mapped column",
}


@pytest.mark.parametrize("text", WRONG)
def test_maps_that_do_not_fit(tmp_path: Path, text: str) -> None:
    path = write(FRAME, tmp_path / "log.csv")
    with pytest.raises(RecordingError, match=WRONG[text]) as caught:
        mapped(tmp_path, path, text)
    assert "\n" not in str(caught.value)


def test_without_time_the_columns_are_listed(tmp_path: Path) -> None:
    path = write(FRAME.drop(columns="timestamp [ms]"), tmp_path / "log.csv")
    with pytest.raises(RecordingError, match=r"has no 'time'; it has the columns 'yaw_pos"):
        Recording.load(path)


def test_two_times_are_not_guessed_between(tmp_path: Path) -> None:
    frame = FRAME.assign(t=TIMES / 1e3)
    with pytest.raises(RecordingError, match=r"'timestamp \[ms\]' and 't' both look like the time"):
        Recording.load(write(frame, tmp_path / "log.csv"))


def test_the_same_signal_in_two_units(tmp_path: Path) -> None:
    frame = pd.DataFrame({"time": [0.0], "qpos/a [deg]": [1.0], "qpos/a [rad]": [1.0]})
    with pytest.raises(RecordingError, match="are both 'qpos/a'"):
        Recording.load(write(frame, tmp_path / "log.csv"))


def test_files_of_save_are_taken_to_the_letter(tmp_path: Path) -> None:
    recording = Recording([0.0, 1.0], {"qpos/a [deg]": [1.0, 2.0], "ctrl/b (ms)": [3.0, 4.0]})
    for suffix in (".csv", ".parquet", ".npz"):
        recording.save(tmp_path / f"a{suffix}")
        assert Recording.load(tmp_path / f"a{suffix}") == recording


def test_many_ignored_columns_are_one_note(tmp_path: Path) -> None:
    frame = pd.DataFrame({"time": [0.0], **{f"c{i}": [1] for i in range(20)}})
    recording = Recording.load(write(frame, tmp_path / "log.csv"))
    assert len(recording.notes) == 1
    assert "ignored 20 columns" in recording.notes[0]
    assert len(recording.columns) == 20


def test_groups_with_clocks_and_no_signals(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["a/time"], file["a/x"], file["b/y"] = [0.0, 1.0], [1.0, 2.0], [1.0]
    recording = Recording.load(tmp_path / "log.h5")
    assert (len(recording), recording.columns) == (2, ("a/x", "b/y"))


def test_a_header_without_end(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"time,{'a ' * 50_000}[deg]\n0,1\n1,2\n")
    assert len(Recording.load(tmp_path / "a.csv")) == 2


def test_clocks_that_do_not_meet(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["a/time"], file["a/q"] = [0.0, 1.0, 2.0], [1.0, 2.0, 3.0]
        file["b/time"], file["b/x"] = [10.0, 11.0], [1.0, 2.0]
    text = "columns: {a/q: qpos/a, b/x: sensor/x}"
    with pytest.raises(RecordingError, match="do not meet those of the other signals"):
        mapped(tmp_path, tmp_path / "log.h5", text)


def test_words_are_no_times(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["a/time"], file["a/q"] = np.array([b"x", b"y"]), [1.0, 2.0]
        file["b/time"], file["b/x"] = [0.0, 1.0], [1.0, 2.0]
    text = "columns: {a/q: qpos/a, b/x: sensor/x}"
    with pytest.raises(RecordingError, match="'a/time': must hold numbers"):
        mapped(tmp_path, tmp_path / "log.h5", text)
