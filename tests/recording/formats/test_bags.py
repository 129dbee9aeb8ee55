"""ROS 1 and 2 bags and MCAP, as their own libraries write them."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from orbisim import Recording
from orbisim.errors import RecordingError

from . import bags

MAP = """
columns:
  /joint_states/position/shoulder: qpos/shoulder
  /joint_states/position/elbow: qpos/elbow
  /imu/angular_velocity: sensor/gyro
  /cube/pose.position: xpos/cube
  /cube/pose.orientation: xquat/cube
  /motor/command/data: {signal: ctrl/motor, unit: mNm}
"""
MAKERS = {
    "1.bag": lambda path: bags.bag1(path),
    "bz2.bag": lambda path: bags.bag1(path, "bz2"),
    "lz4.bag": lambda path: bags.bag1(path, "lz4"),
    "sqlite": lambda path: bags.bag2(path),
    "folder": lambda path: bags.bag2(path, "mcap"),
    "by_message": lambda path: bags.bag2(path, compression="message"),
    "by_file": lambda path: bags.bag2(path, compression="file"),
    "a.mcap": lambda path: bags.mcap_file(path),
    "lz4.mcap": lambda path: bags.mcap_file(path, "lz4"),
    "plain.mcap": lambda path: bags.mcap_file(path, "none"),
    "ros1.mcap": lambda path: bags.mcap_file(path, encoding="ros1"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags")
    for name, make in MAKERS.items():
        make(path / name)
    (path / "map.yaml").write_text(MAP)
    return path


@pytest.mark.parametrize("name", MAKERS)
def test_joint_states_need_no_map(folder: Path, name: str) -> None:
    recording = Recording.load(folder / name)
    np.testing.assert_allclose(recording.time, bags.JOINTS, atol=1e-9)
    q = bags.angles(bags.JOINTS)
    np.testing.assert_allclose(recording["qpos/shoulder"], q[:, 0])
    np.testing.assert_allclose(recording["qvel/elbow"], 2 * q[:, 1])
    assert set(recording.signals) == {
        f"{kind}/{joint}" for kind in ("qpos", "qvel") for joint in bags.NAMES
    }
    assert any("1700000000.000000 s since 1970" in note for note in recording.notes)
    assert any("ignored topic '/chatter'" in note for note in recording.notes)
    assert "/imu/linear_acceleration" in recording.columns
    assert "/imu/orientation" not in recording.columns  # its covariance says: not measured


@pytest.mark.parametrize("name", MAKERS)
def test_streams_of_other_rates_are_resampled(folder: Path, name: str) -> None:
    recording = Recording.load(folder / name, folder / "map.yaml")
    time = recording.time
    np.testing.assert_allclose(recording["sensor/gyro"], np.stack([time, 0 * time, -time], 1),
                               atol=1e-9)  # fmt: skip
    np.testing.assert_allclose(recording["xpos/cube"][:, 0], time, atol=1e-9)
    np.testing.assert_allclose(recording["xquat/cube"][7], [0.5, 0.5, -0.5, 0.5])
    # commands have no stamp of their own: they count from their arrival, a microsecond later
    assert np.isnan(recording["ctrl/motor"][0])
    np.testing.assert_allclose(recording["ctrl/motor"][1:], 3e-3 * time[:-1], atol=1e-9)
    assert recording.units["ctrl/motor"] == "N*m"
    assert any("'sensor/gyro' were sampled at 200 Hz" in note for note in recording.notes)


def test_a_database_alone(folder: Path) -> None:
    (path,) = (folder / "sqlite").glob("*.db3")
    assert Recording.load(path) == Recording.load(folder / "sqlite")


def test_json_in_mcap(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(
        'columns: {"/drive/u[0]": ctrl/a, /drive/state.temp: sensor/t}'
    )
    recording = Recording.load(folder / "a.mcap", tmp_path / "map.yaml")
    np.testing.assert_allclose(recording["ctrl/a"], bags.JOINTS)
    np.testing.assert_allclose(recording["sensor/t"], 20)


def test_a_file_that_ends_early_is_read_as_far_as_it_goes(folder: Path, tmp_path: Path) -> None:
    content = (folder / "a.mcap").read_bytes()
    middle = len(content) // 2
    for cut in range(middle, middle + 1000, 5):  # within a record's kind, length and content
        (tmp_path / "cut.mcap").write_bytes(content[:cut])
        recording = Recording.load(tmp_path / "cut.mcap")
        assert 5 < len(recording) < len(bags.JOINTS)
        assert any("ends early" in note for note in recording.notes)


def test_two_topics_of_joint_states_are_not_guessed_between(tmp_path: Path) -> None:
    store = bags.get_typestore(bags.Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/JointState"
    with bags.rosbags.rosbag2.Writer(tmp_path / "bag", version=9) as writer:
        for topic in ("/joint_states", "/left/joint_states", "/joint_commands"):
            connection = writer.add_connection(topic, kind, typestore=store)
            for other, _, stamp, message in bags.messages(store):
                if other == "/joint_states":
                    writer.write(connection, stamp, store.serialize_cdr(message, kind))
    with pytest.raises(RecordingError, match=r"are both 'qpos/shoulder'.*choose one in a map"):
        Recording.load(tmp_path / "bag")


WRONG = {
    "text.bag": (b"hello\n", "is damaged"),
    "text.mcap": (b"hello", "is damaged"),
    "text.db3": (b"hello", "is damaged"),
    "cut.bag": (b"#ROSBAG V2.0\n\x45\x00\x00\x00", "is damaged"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_bag(tmp_path: Path, name: str) -> None:
    content, problem = WRONG[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RecordingError, match=problem) as caught:
        Recording.load(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_folders(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"has neither meta/info.json nor metadata.yaml"):
        Recording.load(tmp_path)
    (tmp_path / "metadata.yaml").write_text("")
    with pytest.raises(RecordingError, match=r"no \.db3 or \.mcap files"):
        Recording.load(tmp_path)
    shutil.copytree(folder / "sqlite", tmp_path / "bag")
    with pytest.raises(RecordingError, match="has no part '2'"):
        Recording.load(f"{tmp_path / 'bag'}#2")


def test_a_view_in_the_place_of_a_table_is_refused(tmp_path: Path) -> None:
    import sqlite3

    with sqlite3.connect(tmp_path / "a.db3") as database:
        database.executescript(
            "CREATE TABLE topics(id, name, type, serialization_format);"
            "CREATE VIEW messages AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x FROM c) "
            "SELECT x AS topic_id, x AS timestamp, x AS data FROM c;"
        )
    with pytest.raises(RecordingError, match="has no table 'messages'"):
        Recording.load(tmp_path / "a.db3")


def test_a_bomb_is_refused(tmp_path: Path) -> None:
    import bz2

    from orbisim.recording.formats.unpacking import unpacked

    bomb = bz2.compress(bytes(80 * 2**20))
    assert len(bomb) < 1000
    with pytest.raises(ValueError, match="does not unpack"):
        unpacked(bomb, "bz2")
    with pytest.raises(ValueError, match="says that it unpacks to"):
        unpacked(bomb, "zstd", 2**40)
    with pytest.raises(ValueError, match="known are bz2, lz4 and zstd"):
        unpacked(bomb, "rar")
