"""Kinds of logs for `fuzz_files`: how to write one, damage it, and read it.

Bags and MCAP files are damaged uncompressed, so that what is damaged reaches the messages, and in
some cases compressed.
"""

from __future__ import annotations

import contextlib
import json
import random
import sqlite3
import struct
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow
import pyarrow.parquet
from fuzz_mutations import BYTES, TOKENS
from fuzz_values import damage_hdf5, damaged_array, damaged_json

sys.path.insert(0, str(Path(__file__).parent.parent))
from orbisim import Recording, load_scene
from orbisim.errors import OrbiSimError
from orbisim.recording.files import opened
from orbisim.recording.summary import summarize
from orbisim.recording.template import propose
from tests.recording.formats import bags

SCENE = """
<mujoco model="arm">
  <worldbody>
    <body name="upper"><joint name="shoulder" axis="0 1 0"/><geom size=".1"/>
      <body name="lower" pos="0 0 .4"><joint name="elbow" axis="0 1 0"/><geom size=".1"/>
        <site name="wrist"/></body></body>
    <body name="cube" pos="1 0 1"><freejoint name="cube"/><geom size=".1"/></body>
  </worldbody>
  <actuator><motor name="shoulder" joint="shoulder"/></actuator>
  <sensor><gyro name="gyro" site="wrist"/></sensor>
</mujoco>
"""
MAPS = {
    "csv": """columns:
  "timestamp [ms]": {signal: time, unit: ms}
  "shoulder_pos [deg]": {signal: qpos/shoulder, sign: -1, offset: 12.5, scale: 2}
  elbow_counts: {signal: qpos/elbow, unit: rev, scale: 0.000244140625}
  "cmd [mNm]": ctrl/shoulder
""",
    "hdf5": """clock: joints/q
columns:
  "joints/q[0]": {signal: qpos/shoulder, unit: deg}
  "joints/q[1]": qpos/elbow
  imu/gyro: sensor/gyro
""",
    "ros": """columns:
  /joint_states/position/shoulder: qpos/shoulder
  /joint_states/position/elbow: qpos/elbow
  /imu/angular_velocity: sensor/gyro
  /cube/pose.position: xpos/cube
  /cube/pose.orientation: xquat/cube
  /motor/command/data: {signal: ctrl/shoulder, unit: mNm}
""",
    "lerobot": """columns:
  observation.state/shoulder.pos: {signal: qpos/shoulder, unit: deg}
  observation.state/elbow.pos: {signal: qpos/elbow, unit: deg}
  "action[0]": ctrl/shoulder
""",
}
_HEADERS = (
    "time", "time [ms]", "t", "timestamp [ns]", "[deg]", "a [", "a ]", "qpos/shoulder [deg]",
    "qpos/shoulder [N]", "qpos/cube[3] [mm]", "xpos/cube/x [mm]", "x" * 10**5, "\u202e [deg]",
    "qpos/shoulder [SI]", "_deg", "q_rad_s", " [ ]", "([deg])", "qpos/a [deg^9]", "a [deg/deg]",
)  # fmt: skip


_ODD_MAPS = (
    b"[" * 3000, b"a: &a [*a]", b"columns: {a: " + b"9" * 5000 + b"}", b"columns: 2024-13-99",
    b"a: &x [x,x]\nb: &y [*x,*x]\ncolumns: {a: {signal: *y}}", b"\xff\xfe", b"? {a: 1}\n: 2",
    b"columns: {<<: {a: time}}", b"columns: {a: !!binary x}", b"columns: !!set {a}",
    b"columns: {a: {signal: time, offset: 1e400}}", b"a: &a\n  columns: *a",
    b"columns: {a: {signal: qpos/a, sign: {}}}",
)  # fmt: skip


def _reader(name: str) -> Callable[[Path], None]:
    """Loads a log with its map, and looks into it, as the command line does."""
    scene = load_scene(SCENE, trusted=True)

    def read(folder: Path) -> None:
        path = str(folder / name)
        steps = (
            lambda: Recording.load(path, folder / "map.yaml"),
            lambda: summarize(opened(path), scene),
            lambda: propose(opened(path), scene),
        )
        first: OrbiSimError | None = None
        for step in steps:
            try:
                step()
            except OrbiSimError as error:
                first = first or error
                if error.exit_status != 2 or "\n" in str(error):
                    raise
        if first is not None:
            raise first

    return read


def _maker(kind: str, make: Callable[[Path], Any]) -> Callable[[Path], None]:
    def both(folder: Path) -> None:
        make(folder)
        (folder / "map.yaml").write_text(MAPS[kind])

    return both


def _damage_map(folder: Path, rng: random.Random) -> None:
    path = folder / "map.yaml"
    if rng.random() < 0.3:
        text = rng.choice(_ODD_MAPS)
        path.write_bytes(text)
    else:
        path.write_bytes(rng.choice((*BYTES, *TOKENS))(path.read_bytes() or b"\n", rng))


# -- tables and arrays ---------------------------------------------------------------------------


def _make_csv(folder: Path) -> None:
    rows = np.arange(60)
    table = np.stack([1.7e12 + 10 * rows, 30 * np.sin(rows / 9), 7 * rows, 100 * np.cos(rows)], 1)
    lines = ["timestamp [ms],shoulder_pos [deg],elbow_counts,cmd [mNm],note"]
    lines += [",".join(repr(float(v)) for v in row) + ",ok" for row in table]
    (folder / "log.csv").write_text("\n".join(lines) + "\n")


def _damage_csv(folder: Path, rng: random.Random) -> None:
    path = folder / "log.csv"
    rows = [line.split(",") for line in path.read_text().splitlines()]
    how = rng.randrange(7)
    row, column = rng.randrange(1, len(rows)), rng.randrange(len(rows[0]))
    if how == 0:
        _damage_map(folder, rng)
    elif how in (1, 2):
        rows[0][column] = rng.choice(_HEADERS)
    elif how == 3:
        rows[row][column] = rng.choice(
            (
                "nan",
                "inf",
                "1e300",
                "",
                "2024-05-01 12:00:00.5",
                "9" * 400,
                "12:00",
                "true",
                "\0",
                "-0",
            )
        )
    elif how == 4:
        stamp = rng.choice(("2024-05-01 12:00:{:02d}", "{}999999999999999", "-{}", "{}.5", "{}e18"))
        for index, one in enumerate(rows[1:]):
            one[0] = stamp.format(index)
    elif how == 5:
        rows[0] += [rng.choice(_HEADERS) + str(i) for i in range(rng.choice((3, 3000)))]
    else:
        rows = [one[:column] + one[column + 1 :] for one in rows]
    mark = rng.choice((",", ",", ",", ";", "\t"))
    path.write_text("\n".join(mark.join(one) for one in rows))


def _make_hdf5(folder: Path) -> None:
    time = np.arange(0, 1, 0.01)
    with h5py.File(folder / "log.h5", "w") as file:
        file["joints/time"] = time
        file["joints/q"] = np.stack([30 * np.sin(time), 0.1 * time], axis=1)
        file["joints/q"].attrs["units"] = "deg"
        file["imu/time_ms"] = np.arange(0, 1000, 5)
        file.create_dataset("imu/gyro", data=np.ones((200, 3)), compression="gzip", chunks=(50, 3))
        file["note"] = np.bytes_("hello")


def _damage_hdf5(folder: Path, rng: random.Random) -> None:
    if rng.random() < 0.15:
        _damage_map(folder, rng)
    else:
        damage_hdf5(folder / "log.h5", rng)


# -- messages ------------------------------------------------------------------------------------

_LENGTHS = (0, 1, 2**31 - 1, 2**31, 2**32 - 1)
_LONG = (0, 2**31, 2**40, 2**62, 2**63 - 1, 2**64 - 1)


def _damage_lengths(path: Path, rng: random.Random) -> None:
    """Puts absurd numbers where lengths, places and times may stand, and numbers that are none."""
    content = bytearray(path.read_bytes())
    for _ in range(rng.choice((1, 1, 4, 30))):
        place = rng.randrange(max(1, len(content) - 8))
        value = rng.choice(
            (
                struct.pack("<I", rng.choice(_LENGTHS)),
                struct.pack("<Q", rng.choice(_LONG)),
                struct.pack("<d", rng.choice((float("nan"), float("inf"), 1e300))),
                struct.pack("<I", rng.randrange(len(content))),
                struct.pack("<Q", rng.randrange(len(content))),
            )
        )
        content[place : place + len(value)] = value
    path.write_bytes(content)


def _damage_ros(name: str) -> Callable[[Path, random.Random], None]:
    def damage(folder: Path, rng: random.Random) -> None:
        if rng.random() < 0.1:
            _damage_map(folder, rng)
            return
        path = folder / name
        how = rng.randrange(3)
        if how == 0:
            _damage_lengths(path, rng)
        elif how == 1:
            words = b"position /imu /joint_states sensor_msgs/ JointState elbow cdr json ros1 conn"
            words += b" topic chunk none shoulder"
            content = path.read_bytes()
            old, new = rng.sample(words.split(), 2)
            path.write_bytes(content.replace(old, new[: len(old)].ljust(len(old), b"_"), 3))
        else:
            path.write_bytes(rng.choice(BYTES)(path.read_bytes() or b"\n", rng))

    return damage


@contextlib.contextmanager
def _short_bags() -> Iterator[None]:
    """Bags of a fifth of the messages that the tests write: small files, many cases."""
    whole = bags.JOINTS, bags.IMU
    bags.JOINTS, bags.IMU = bags.JOINTS[:10], bags.IMU[:40]
    try:
        yield
    finally:
        bags.JOINTS, bags.IMU = whole


def _make_bag1(folder: Path) -> None:
    with _short_bags():
        bags.bag1(folder / "log.bag")


def _make_packed_bag1(folder: Path) -> None:
    with _short_bags():
        bags.bag1(folder / "log.bag", "bz2")


def _make_bag2(folder: Path) -> None:
    with _short_bags():
        bags.bag2(folder / "bag")


def _damage_bag2(folder: Path, rng: random.Random) -> None:
    """Damages a database by what it means."""
    (path,) = (folder / "bag").glob("*.db3")
    how = rng.randrange(8)
    if how == 0:
        _damage_map(folder, rng)
        return
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        steps = iter(range(1000))
        database.set_progress_handler(lambda: next(steps, None) is None, 10_000)
        (kind,) = database.execute(
            "SELECT type FROM sqlite_master WHERE name = 'messages'"
        ).fetchone()
        if kind != "table":  # damaged before, and endless
            return
        rows = database.execute("SELECT id, data FROM messages").fetchall()
        number, data = rng.choice(rows)
        if how <= 3:
            for number, data in rng.sample(rows, rng.choice((1, 1, 50))):
                changed = rng.choice(BYTES)(data or b"\0", rng)
                if rng.random() < 0.2:
                    changed = b"\x28\xb5\x2f\xfd" + changed
                database.execute("UPDATE messages SET data = ? WHERE id = ?", (changed, number))
        elif how == 4:
            value = rng.choice((None, "x", 1e300, -1, 2**62, b"x", 0, -(2**63)))
            database.execute("PRAGMA ignore_check_constraints = ON")
            column = rng.choice(("data", "timestamp", "topic_id"))
            with contextlib.suppress(sqlite3.Error):
                database.execute(f"UPDATE messages SET {column} = ? WHERE id = ?", (value, number))
        elif how == 5:
            column = rng.choice(("name", "type", "serialization_format"))
            value = rng.choice(("", "x" * 10**6, "sensor_msgs/msg/Imu", "ros1", "json", b"\xff", 3))
            with contextlib.suppress(sqlite3.Error):
                database.execute(f"UPDATE topics SET {column} = ?", (value,))
        elif how == 6:
            table = rng.choice(("messages", "topics", "schema", "metadata"))
            database.execute(f"DROP TABLE {table}")
            if rng.random() < 0.5:
                database.execute(
                    f"CREATE VIEW {table} AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x "
                    "FROM c) SELECT x AS id, x AS topic_id, x AS timestamp, x AS data FROM c"
                )
        else:
            big = b"\x00\x01\x00\x00" + bytes(rng.choice((0, 10, 10**7)))
            database.execute("UPDATE messages SET data = ? WHERE id = ?", (big, number))


def _make_mcap(folder: Path) -> None:
    with _short_bags():
        bags.mcap_file(folder / "log.mcap", "none")


def _make_packed_mcap(folder: Path) -> None:
    with _short_bags():
        bags.mcap_file(folder / "log.mcap", "zstd")


# -- LeRobot -------------------------------------------------------------------------------------


def _make_lerobot(folder: Path) -> None:
    feature = {"dtype": "float32", "shape": [2], "names": ["shoulder.pos", "elbow.pos"]}
    info = {
        "codebase_version": "v3.0", "fps": 30, "total_episodes": 1, "chunks_size": 1000,
        "features": {"observation.state": feature, "action": {**feature, "names": None},
                     "timestamp": {"dtype": "float32", "shape": [1]}},
    }  # fmt: skip
    (folder / "set/meta").mkdir(parents=True)
    (folder / "set/data/chunk-000").mkdir(parents=True)
    (folder / "set/meta/info.json").write_text(json.dumps(info))
    state = np.random.default_rng(0).standard_normal((90, 2)).cumsum(0)
    wide = pyarrow.list_(pyarrow.float32(), 2)
    table = pyarrow.table(
        {
            "observation.state": pyarrow.array(state.tolist(), wide),
            "action": pyarrow.array(state.tolist(), pyarrow.list_(pyarrow.float32())),
            "timestamp": np.arange(90) / 30,
            "episode_index": np.zeros(90, np.int64),
        }
    )
    pyarrow.parquet.write_table(table, folder / "set/data/chunk-000/file-000.parquet")


def _damage_lerobot(folder: Path, rng: random.Random) -> None:
    how = rng.randrange(6)
    info = folder / "set/meta/info.json"
    file = folder / "set/data/chunk-000/file-000.parquet"
    if how == 0:
        _damage_map(folder, rng)
    elif how <= 2:
        info.write_text(damaged_json(json.loads(info.read_text()), rng))
    elif how == 3:
        path = rng.choice((info, file))
        path.write_bytes(rng.choice(BYTES)(path.read_bytes() or b"\n", rng))
    else:
        _damage_table(file, rng)


def _damage_table(path: Path, rng: random.Random) -> None:
    table = pyarrow.parquet.read_table(path)
    column = rng.randrange(table.num_columns)
    name, count = table.column_names[column], len(table)
    flat = np.arange(float(count))
    odd: list[Any] = [
        [[1.0]] * (count - 1) + [[1.0, 2.0]], [None] * count, [[]] * count, ["x"] * count,
        [[["x"]]] * count, [[1.0] * 500] * count, [{"a": 1}] * count, [b"x"] * count,
        [[None, 1.0]] * count, [2**62] * count, list(flat[::-1]), [True] * count,
    ]  # fmt: skip
    if rng.random() < 0.2:
        table = table.remove_column(column)
    elif rng.random() < 0.2:
        table = table.append_column(name, table.column(column))
    elif rng.random() < 0.3:
        changed = damaged_array(flat, rng)
        plain = changed.shape == flat.shape and changed.dtype.kind in "iuf"
        table = table.set_column(column, name, pyarrow.array(changed if plain else flat))
    else:
        table = table.set_column(column, name, pyarrow.array(rng.choice(odd)))
    pyarrow.parquet.write_table(table, path)


PARTS: dict[str, tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any], str]] = {
    "log_csv": (_maker("csv", _make_csv), _damage_csv, _reader("log.csv"), "*"),
    "log_hdf5": (_maker("hdf5", _make_hdf5), _damage_hdf5, _reader("log.h5"), "*.h5"),
    "log_bag": (_maker("ros", _make_bag1), _damage_ros("log.bag"), _reader("log.bag"),
                "*.bag"),
    "log_bag_packed": (_maker("ros", _make_packed_bag1), _damage_ros("log.bag"),
                       _reader("log.bag"), "*.bag"),
    "log_rosbag2": (_maker("ros", _make_bag2), _damage_bag2, _reader("bag"), "bag/*"),
    "log_mcap": (_maker("ros", _make_mcap), _damage_ros("log.mcap"), _reader("log.mcap"),
                 "*.mcap"),
    "log_mcap_packed": (_maker("ros", _make_packed_mcap), _damage_ros("log.mcap"),
                        _reader("log.mcap"), "*.mcap"),
    "log_lerobot": (_maker("lerobot", _make_lerobot), _damage_lerobot, _reader("set"),
                    "set/**/*"),
}  # fmt: skip
"""How to make, damage and read each kind, and which files have their bytes damaged."""
