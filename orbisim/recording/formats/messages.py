"""ROS messages as columns: joint states, poses, inertial units and the like.

The types are those of the ROS distributions themselves, by name; definitions that a file carries
along are not run. Quaternions become w, x, y, z. A column is named `<topic>/<field>`, of joint
states `<topic>/position/<joint>`; each topic has a clock of its own, that of the stamps in its
messages' headers, or of their arrival where these are empty.
"""

from __future__ import annotations

import abc
import array
import collections
import contextlib
import dataclasses
import functools
import json
import math
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from orbisim.errors import OrbiSimError, RecordingError
from orbisim.files.reading import Allowance
from orbisim.recording.formats.log import Array, Column, Log

Floats = npt.NDArray[np.float64]
Encoding = Literal["cdr", "ros1", "json"]

_XYZ, _WXYZ = "xyz", "wxyz"
_MOST_JOINTS = 1000
"""Names of joints on one topic; humanoids have some dozens."""
_MOST_LEAVES = 500
"""Numbers in one JSON message."""
_DEEPEST = 8
"""Values within each other in a JSON message: those below are no signals of a robot."""
_COMMAND = ("command", "cmd", "desired", "target", "goal", "reference", "setpoint")
"""Topics with these words hold what a joint should do, not what it does."""


@dataclasses.dataclass(frozen=True)
class Message:
    """A message as a file has it. stamp: of its arrival, ns. type: `package/msg/Name`."""

    topic: str
    type: str
    encoding: Encoding
    stamp: int
    data: bytes


@dataclasses.dataclass(frozen=True)
class Field:
    """A part of a message. name: of the column. paths: of its components. unit: by convention of
    ROS (REP 103). valid: path of a number that is -1 where the field is not measured."""

    name: str
    paths: tuple[str, ...]
    unit: str
    valid: str | None = None


def _vector(path: str, unit: str) -> Field:
    return Field(path, tuple(f"{path}.{axis}" for axis in _XYZ), unit)


def _pose(path: str) -> tuple[Field, ...]:
    inside = f"{path}." if path else ""
    turn = f"{inside}orientation"
    quaternion = Field(turn, tuple(f"{turn}.{axis}" for axis in _WXYZ), "1")
    return (_vector(f"{inside}position", "m"), quaternion)


def _pair(path: str, one: tuple[str, str], other: tuple[str, str]) -> tuple[Field, ...]:
    inside = f"{path}." if path else ""
    return (_vector(f"{inside}{one[0]}", one[1]), _vector(f"{inside}{other[0]}", other[1]))


_LINEAR, _ANGULAR = ("linear", "m/s"), ("angular", "rad/s")
_WRENCH = (("force", "N"), ("torque", "N*m"))
_FIELDS: Mapping[str, tuple[Field, ...]] = {
    "sensor_msgs/msg/Imu": (
        Field("orientation", tuple(f"orientation.{a}" for a in _WXYZ), "1",
              "orientation_covariance"),
        Field("angular_velocity", tuple(f"angular_velocity.{a}" for a in _XYZ), "rad/s",
              "angular_velocity_covariance"),
        Field("linear_acceleration", tuple(f"linear_acceleration.{a}" for a in _XYZ), "m/s^2",
              "linear_acceleration_covariance"),
    ),
    "sensor_msgs/msg/MagneticField": (_vector("magnetic_field", "T"),),
    "sensor_msgs/msg/Range": (Field("range", ("range",), "m"),),
    "geometry_msgs/msg/Pose": _pose(""),
    "geometry_msgs/msg/PoseStamped": _pose("pose"),
    "geometry_msgs/msg/PoseWithCovariance": _pose("pose"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _pose("pose.pose"),
    "geometry_msgs/msg/TransformStamped": (
        _vector("transform.translation", "m"),
        Field("transform.rotation", tuple(f"transform.rotation.{a}" for a in _WXYZ), "1"),
    ),
    "geometry_msgs/msg/PointStamped": (_vector("point", "m"),),
    "geometry_msgs/msg/Twist": _pair("", _LINEAR, _ANGULAR),
    "geometry_msgs/msg/TwistStamped": _pair("twist", _LINEAR, _ANGULAR),
    "geometry_msgs/msg/Wrench": _pair("", *_WRENCH),
    "geometry_msgs/msg/WrenchStamped": _pair("wrench", *_WRENCH),
    "geometry_msgs/msg/Vector3Stamped": (_vector("vector", ""),),
    "geometry_msgs/msg/AccelStamped": _pair("accel", ("linear", "m/s^2"), ("angular", "rad/s^2")),
    "nav_msgs/msg/Odometry": (*_pose("pose.pose"), *_pair("twist.twist", _LINEAR, _ANGULAR)),
    **{
        f"std_msgs/msg/{kind}": (Field("data", ("data",), ""),)
        for kind in ("Float32", "Float64", "Int8", "Int16", "Int32", "Int64", "UInt8", "UInt16",
                     "UInt32", "UInt64", "Bool")
    },
}  # fmt: skip
_JOINTS = "sensor_msgs/msg/JointState"
_JOINT_PARTS = (("position", "qpos"), ("velocity", "qvel"), ("effort", "torque"))
_LISTS = ("std_msgs/msg/Float32MultiArray", "std_msgs/msg/Float64MultiArray")
TYPES = frozenset({*_FIELDS, _JOINTS, *_LISTS})
"""The message types that are read."""


def normalized(name: str) -> str:
    """`package/Name` as `package/msg/Name`."""
    parts = name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name


def readable(kind: str, encoding: str) -> bool:
    """Whether messages of a type are read."""
    return encoding == "json" or (encoding in ("cdr", "ros1") and kind in TYPES)


@contextlib.contextmanager
def damaged(source: str, where: str = "") -> Iterator[None]:
    """Turns what a library raises over a damaged file, of whatever type, into `RecordingError`."""
    try:
        yield
    except (OrbiSimError, ImportError, MemoryError):
        raise
    except Exception as error:
        text = " ".join(str(error).split())[:200] or type(error).__name__
        raise RecordingError(source, f"{where or 'it'} is damaged ({text})") from None


def log_of(
    source: str, messages: Iterable[Message], allowance: Allowance, notes: Sequence[str] = ()
) -> Log:
    """The columns of messages.

    Args:
      source: the file. messages: of types that are `readable`, in any order.
      allowance: what the columns are counted against. notes: of the reading.

    Raises:
      RecordingError: a message is damaged, or there is none.
    """
    topics: dict[str, _Topic] = {}
    for message in messages:
        topic = topics.get(message.topic)
        if topic is None:
            topic = topics[message.topic] = _topic(message)
        if topic.type != message.type:
            raise RecordingError(
                source, f"has messages of two types on it ({topic.type} and {message.type})",
                element=repr(message.topic[:200]),
            )  # fmt: skip
        with damaged(source, f"message {len(topic.stamps)} of topic {message.topic[:200]!r}"):
            topic.add(message)
    if not topics:
        known = ", ".join(sorted(name.rpartition("/")[2] for name in TYPES))
        raise RecordingError(
            source, f"has no messages of types that are read ({known})" + "".join(notes)
        )
    return _assembled(source, topics, allowance, list(notes))


def _assembled(
    source: str, topics: Mapping[str, _Topic], allowance: Allowance, notes: list[str]
) -> Log:
    start = min(min(topic.times()) for topic in topics.values())
    columns: list[Column] = []
    arrays: dict[str, Array] = {}
    clocks: dict[str, Floats] = {}
    for name, topic in topics.items():
        rows, repeated = _ascending(topic.times())
        if repeated:
            notes.append(f"{repeated} messages of {name!r} that repeat a time are left out")
        clocks[name] = (topic.times()[rows] - start) / 1e9
        for column, values in topic.columns(name, allowance, notes):
            columns.append(dataclasses.replace(column, shape=values[rows].shape, group=name))
            arrays[column.name] = values[rows]
    if start > 10**17:  # since 1970, not since the start of a simulation
        notes.append(f"time counts from the first message, {start / 1e9:.6f} s since 1970")

    def read(wanted: Sequence[str]) -> Mapping[str, Array]:
        return {each: arrays[each] for each in wanted}

    return Log(source, tuple(columns), read, clocks=clocks, notes=tuple(notes))


def _ascending(times: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.intp], int]:
    """Rows in the order of time, each time once, and how many were left out."""
    rows = np.argsort(times, kind="stable")
    keep = np.concatenate([[True], np.diff(times[rows]) > 0])
    return rows[keep], int((~keep).sum())


# -- topics ------------------------------------------------------------------------------------


class _Topic(abc.ABC):
    """Gathers the messages of one topic.

    Attributes:
      type: of its messages. stamps: of the headers. arrivals: of the messages; ns.
    """

    def __init__(self, message: Message) -> None:
        self.type = message.type
        self.stamps, self.arrivals = array.array("q"), array.array("q")
        self._decode = _decoder(message.encoding, message.type)

    def add(self, message: Message) -> None:
        """Takes a message."""
        decoded = self._decode(message.data)
        self.take(decoded)
        header = getattr(decoded, "header", None)
        stamp = 0 if header is None else header.stamp.sec * 10**9 + header.stamp.nanosec
        self.stamps.append(stamp)
        self.arrivals.append(message.stamp)

    @abc.abstractmethod
    def take(self, decoded: Any) -> None:
        """Takes the numbers of a message."""

    @abc.abstractmethod
    def columns(
        self, topic: str, allowance: Allowance, notes: list[str]
    ) -> Iterator[tuple[Column, Floats]]:
        """The columns and their samples."""

    def times(self) -> npt.NDArray[np.int64]:
        """[T], ns: of the headers, or of arrival if these are empty."""
        stamps = np.array(self.stamps, np.int64)
        return stamps if stamps.any() else np.array(self.arrivals, np.int64)


class _Plain(_Topic):
    """Messages with the same numbers each time."""

    def __init__(self, message: Message) -> None:
        super().__init__(message)
        self._fields = _FIELDS[message.type]
        paths = [path for field in self._fields for path in field.paths]
        self._get: Callable[[Any], Any] = operator.attrgetter(*paths)
        self._single = len(paths) == 1
        self._values = array.array("d")

    def take(self, decoded: Any) -> None:
        found = self._get(decoded)
        values = [float(found)] if self._single else [float(value) for value in found]
        place = 0
        for field in self._fields:
            if field.valid is not None and getattr(decoded, field.valid)[0] == -1:
                values[place : place + len(field.paths)] = [math.nan] * len(field.paths)
            place += len(field.paths)
        self._values.extend(values)

    def columns(
        self, topic: str, allowance: Allowance, notes: list[str]
    ) -> Iterator[tuple[Column, Floats]]:
        table = np.array(self._values, np.float64).reshape(len(self.stamps), -1)
        place = 0
        for field in self._fields:
            values = table[:, place : place + len(field.paths)]
            place += len(field.paths)
            if np.isfinite(values).any():
                alone = len(field.paths) == 1
                name = f"{topic}/{field.name}"
                yield Column(name, unit=field.unit or None), values[:, 0] if alone else values


class _Lists(_Topic):
    """Messages with a list of numbers, of one length."""

    def __init__(self, message: Message) -> None:
        super().__init__(message)
        self._values = array.array("d")
        self._lengths = array.array("q")

    def take(self, decoded: Any) -> None:
        values = np.asarray(decoded.data, np.float64)
        self._lengths.append(len(values))
        self._values.frombytes(values.tobytes())

    def columns(
        self, topic: str, allowance: Allowance, notes: list[str]
    ) -> Iterator[tuple[Column, Floats]]:
        if len(set(self._lengths)) != 1 or not self._lengths[0]:
            notes.append(
                f"ignored {topic!r}: its messages have lists of different lengths, or none"
            )
            return
        table = np.array(self._values, np.float64).reshape(len(self.stamps), -1)
        for index in range(table.shape[1]):
            yield Column(f"{topic}/data[{index}]"), table[:, index]


class _Joints(_Topic):
    """Joint states; each message names the joints that it is about."""

    def __init__(self, message: Message) -> None:
        super().__init__(message)
        self._states: list[tuple[tuple[str, ...], tuple[Floats, ...]]] = []
        self._names: dict[str, int] = {}
        self._last: tuple[str, ...] = ()

    def take(self, decoded: Any) -> None:
        joints = tuple(decoded.name)
        if joints == self._last:
            joints = self._last  # one tuple for all messages
        else:
            self._last = joints
            for joint in joints:
                self._names.setdefault(joint, len(self._names))
        if len(self._names) > _MOST_JOINTS:
            raise ValueError(f"it names more than {_MOST_JOINTS} joints")
        if len(set(joints)) != len(joints):
            raise ValueError("it names a joint twice")
        parts = tuple(np.asarray(getattr(decoded, part), np.float64) for part, _ in _JOINT_PARTS)
        for (part, _), values in zip(_JOINT_PARTS, parts, strict=True):
            if len(values) not in (0, len(joints)):
                raise ValueError(f"it has {len(joints)} names and {len(values)} values of {part}")
        self._states.append((joints, parts))

    def columns(
        self, topic: str, allowance: Allowance, notes: list[str]
    ) -> Iterator[tuple[Column, Floats]]:
        allowance.take(3 * 8 * len(self._states) * len(self._names), f"topic {topic[:200]!r}")
        commanded = any(word in topic.lower() for word in _COMMAND)
        places: dict[tuple[str, ...], list[int]] = {}
        for number, (part, kind) in enumerate(_JOINT_PARTS):
            table = np.full((len(self._states), len(self._names)), np.nan)
            for row, (joints, parts) in enumerate(self._states):
                if len(parts[number]):
                    if joints not in places:
                        places[joints] = [self._names[joint] for joint in joints]
                    table[row, places[joints]] = parts[number]
            for joint, index in self._names.items():
                values = table[:, index]
                if not np.isfinite(values).any():
                    continue
                # drivers that measure no effort report zeros
                unused = kind == "torque" and not np.nan_to_num(values).any()
                signal = None if commanded or unused or not joint else f"{kind}/{joint}"
                yield Column(f"{topic}/{part}/{joint}", signal=signal), values


class _Json(_Topic):
    """JSON objects: their numbers, by the way to them."""

    def __init__(self, message: Message) -> None:
        super().__init__(message)
        self._rows: list[dict[str, float]] = []
        self._names: dict[str, None] = {}

    def take(self, decoded: Any) -> None:
        row = dict(_leaves(decoded, "", 0))
        self._names |= dict.fromkeys(row)
        if len(self._names) > _MOST_LEAVES:
            raise ValueError(f"it has more than {_MOST_LEAVES} numbers")
        self._rows.append(row)

    def columns(
        self, topic: str, allowance: Allowance, notes: list[str]
    ) -> Iterator[tuple[Column, Floats]]:
        allowance.take(8 * len(self._rows) * len(self._names), f"topic {topic[:200]!r}")
        for name in self._names:
            values = np.array([row.get(name, math.nan) for row in self._rows])
            yield Column(f"{topic}/{name}"), values


def _topic(message: Message) -> _Topic:
    if message.encoding == "json":
        return _Json(message)
    special = {_JOINTS: _Joints, **dict.fromkeys(_LISTS, _Lists)}
    return special.get(message.type, _Plain)(message)


# -- decoding ----------------------------------------------------------------------------------


def _decoder(encoding: Encoding, kind: str) -> Callable[[bytes], Any]:
    if encoding == "json":
        return _parsed
    store = _store(encoding)
    decode = store.deserialize_cdr if encoding == "cdr" else store.deserialize_ros1
    return lambda data: decode(data, kind)


@functools.cache
def _store(encoding: Encoding) -> Any:
    """The message types of ROS 1 or ROS 2."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.LATEST)


def _parsed(data: bytes) -> Any:
    try:
        value = json.loads(data)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if not isinstance(value, dict):
        raise ValueError("it is no JSON object")
    return collections.UserDict(value)


def _leaves(value: Any, name: str, depth: int) -> Iterator[tuple[str, float]]:
    """The numbers in a JSON value, by the way to them: `pose.position.x`, `q[3]`."""
    if depth > _DEEPEST:
        return
    if isinstance(value, (dict, collections.UserDict)):
        for key, item in value.items():
            yield from _leaves(item, f"{name}.{key}" if name else str(key), depth + 1)
    elif isinstance(value, list):
        if len(value) > _MOST_LEAVES:
            raise ValueError(f"it has a list of {len(value)} items")
        for index, item in enumerate(value):
            yield from _leaves(item, f"{name}[{index}]", depth + 1)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield name, float(value)
