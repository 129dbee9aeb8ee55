"""`.bag`: ROS 1."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from orbisim.files.reading import Allowance, size_of
from orbisim.recording.formats.log import Log
from orbisim.recording.formats.messages import Message, damaged, log_of, normalized, readable
from orbisim.recording.formats.unpacking import unpacked


class Rosbag1Reader:
    """Reads bags of ROS 1 with the library `rosbags`."""

    def read(self, path: Path, part: str = "") -> Log:
        """The messages of a bag."""
        from rosbags.rosbag1 import Reader

        allowance = Allowance(path, size_of(path))
        with damaged(str(path)):
            bag = Reader(path)
            bag.open()
            try:
                _bound_chunks(bag, allowance)
                return log_of(str(path), _messages(bag, allowance), allowance, _notes(bag))
            finally:
                bag.close()


def _bound_chunks(bag: Any, allowance: Allowance) -> None:
    """Has the bag's chunks unpacked within bounds."""
    from rosbags.rosbag1.reader import decompressors

    kinds = {id(function): kind for kind, function in decompressors.items()}

    def unpack(kind: str, data: bytes) -> bytes:
        found = unpacked(data, kind)
        allowance.take(len(found), "a chunk")
        return found

    for place, chunk in bag.chunks.items():
        kind = kinds[id(chunk.decompressor)]
        bag.chunks[place] = chunk._replace(decompressor=functools.partial(unpack, kind))


def _messages(bag: Any, allowance: Allowance) -> Iterator[Message]:
    chosen = [c for c in bag.connections if readable(normalized(c.msgtype), "ros1")]
    if not chosen:
        return
    for connection, stamp, data in bag.messages(chosen):
        allowance.take(len(data), "a message")
        yield Message(connection.topic, normalized(connection.msgtype), "ros1", stamp, bytes(data))


def _notes(bag: Any) -> list[str]:
    return [
        f"ignored topic {c.topic!r}: messages of type {c.msgtype} are not read"
        for c in bag.connections
        if not readable(normalized(c.msgtype), "ros1")
    ]
