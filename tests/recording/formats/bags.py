"""Bags for tests, written by the libraries of their formats: joints at 50 Hz, an inertial unit at
200 Hz, the pose of a cube, a command."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("mcap")

import mcap.writer
import rosbags.rosbag1
import rosbags.rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore

START = 1_700_000_000_000_000_000
JOINTS = np.arange(0, 1.0, 0.02)
IMU = np.arange(0, 1.0, 0.005)
NAMES = ["shoulder", "elbow"]
_Messages = Iterator[tuple[str, str, int, Any]]


def angles(time: np.ndarray) -> np.ndarray:
    """[T, 2]: the joints' positions."""
    return np.stack([np.sin(time), np.cos(2 * time)], axis=1)


def messages(store: Any, ros1: bool = False) -> _Messages:
    """Topic, type, time in ns, message."""
    types = store.types
    stamp_type, header_type = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]

    def header(time: float) -> Any:
        sec, nanosec = divmod(START + round(time * 1e9), 10**9)
        extra = {"seq": 0} if ros1 else {}
        return header_type(stamp=stamp_type(sec=sec, nanosec=nanosec), frame_id="world", **extra)

    def vector(kind: str, values: Any) -> Any:
        make = types[f"geometry_msgs/msg/{kind}"]
        return make(**dict(zip("xyzw", map(float, values), strict=False)))

    found = []
    for time in JOINTS:
        q = angles(np.array([time]))[0]
        joints = types["sensor_msgs/msg/JointState"](
            header=header(time), name=NAMES, position=q, velocity=2 * q, effort=np.zeros(2)
        )
        pose = types["geometry_msgs/msg/PoseStamped"](
            header=header(time),
            pose=types["geometry_msgs/msg/Pose"](
                position=vector("Point", (time, 2, 3)),
                orientation=vector("Quaternion", (0.5, -0.5, 0.5, 0.5)),
            ),
        )
        command = types["std_msgs/msg/Float64"](data=float(3 * time))
        found += [
            ("/joint_states", "sensor_msgs/msg/JointState", time, joints),
            ("/cube", "geometry_msgs/msg/PoseStamped", time, pose),
            ("/motor/command", "std_msgs/msg/Float64", time, command),
            ("/chatter", "std_msgs/msg/String", time, types["std_msgs/msg/String"](data="hello")),
        ]
    for time in IMU:
        cov = np.zeros(9)
        absent = cov.copy()
        absent[0] = -1
        imu = types["sensor_msgs/msg/Imu"](
            header=header(time),
            orientation=vector("Quaternion", (0, 0, 0, 1)),
            orientation_covariance=absent,
            angular_velocity=vector("Vector3", (time, 0, -time)),
            angular_velocity_covariance=cov,
            linear_acceleration=vector("Vector3", (0, 0, 9.81)),
            linear_acceleration_covariance=cov,
        )
        found.append(("/imu", "sensor_msgs/msg/Imu", time, imu))
    for topic, kind, time, message in sorted(found, key=lambda one: one[2]):
        yield topic, kind, START + round(time * 1e9) + 1000, message


def bag1(path: Path, compression: str = "none") -> Path:
    """A bag of ROS 1."""
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = rosbags.rosbag1.Writer(path)
    if compression != "none":
        writer.set_compression(writer.CompressionFormat[compression.upper()])
    with writer:
        known: dict[str, Any] = {}
        for topic, kind, stamp, message in messages(store, ros1=True):
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(known[topic], stamp, store.serialize_ros1(message, kind))
    return path


def bag2(path: Path, storage: str = "sqlite3", compression: str = "none") -> Path:
    """A bag of ROS 2: a folder."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = rosbags.rosbag2.Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if compression != "none":
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        known: dict[str, Any] = {}
        for topic, kind, stamp, message in messages(store):
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(known[topic], stamp, store.serialize_cdr(message, kind))
    return path


def mcap_file(path: Path, compression: str = "zstd", encoding: str = "cdr") -> Path:
    """A file of MCAP."""
    store = get_typestore(Stores.ROS2_HUMBLE if encoding == "cdr" else Stores.ROS1_NOETIC)
    serialize: Callable[..., Any] = (
        store.serialize_cdr if encoding == "cdr" else store.serialize_ros1
    )
    with path.open("wb") as file:
        writer = mcap.writer.Writer(
            file, compression=mcap.writer.CompressionType[compression.upper()], chunk_size=4096
        )
        writer.start(profile="ros2" if encoding == "cdr" else "ros1", library="test")
        known: dict[str, int] = {}
        for topic, kind, stamp, message in messages(store, ros1=encoding == "ros1"):
            if topic not in known:
                text, _ = store.generate_msgdef(kind)
                name = kind if encoding == "cdr" else kind.replace("/msg/", "/")
                schema = writer.register_schema(name, f"{encoding[:4]}msg", text.encode())
                known[topic] = writer.register_channel(topic, encoding, schema)
            data = bytes(serialize(message, kind))
            writer.add_message(known[topic], stamp, data, stamp)
        schema = writer.register_schema("drive", "jsonschema", b"{}")
        channel = writer.register_channel("/drive", "json", schema)
        for time in JOINTS:
            data = json.dumps({"u": [time, 2.0], "state": {"temp": 20}, "ok": True}).encode()
            stamp = START + round(time * 1e9)
            writer.add_message(channel, stamp, data, stamp)
        writer.finish()
    return path
