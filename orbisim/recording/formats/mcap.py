"""`.mcap`: messages of ROS 1 and 2 and JSON, in MCAP's container."""

from __future__ import annotations

import dataclasses
import mmap
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from orbisim.errors import RecordingError
from orbisim.files.reading import Allowance, size_of
from orbisim.recording.formats.log import Log
from orbisim.recording.formats.messages import Message, damaged, log_of, normalized, readable
from orbisim.recording.formats.unpacking import unpacked

_ENCODINGS = {"cdr": "cdr", "ros1": "ros1", "json": "json"}
_MOST_CHANNELS = 10_000
"""Channels and schemas are kept while the file is read; robots have some hundreds."""


class McapReader:
    """Reads MCAP files with the library `mcap`, from the first record to the last."""

    def read(self, path: Path, part: str = "") -> Log:
        """The messages of a file."""
        allowance = Allowance(path, size_of(path))
        notes: list[str] = []
        with damaged(str(path)):
            return log_of(str(path), list_messages(path, allowance, notes), allowance, notes)


def list_messages(path: Path, allowance: Allowance, notes: list[str]) -> list[Message]:
    """The messages that are read; what is left out goes to `notes`."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        return list(_messages(content, path, allowance, notes))


def _messages(
    content: Any, path: Path, allowance: Allowance, notes: list[str]
) -> Iterator[Message]:
    from mcap.records import Channel, Schema
    from mcap.records import Message as Record

    schemas: dict[int, str] = {}
    channels: dict[int, Channel] = {}
    ignored: dict[str, None] = {}
    for record in _records(content, allowance, notes):
        if isinstance(record, Schema):
            schemas[record.id] = record.name
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Record):
            channel = channels.get(record.channel_id)
            if channel is None:
                raise RecordingError(str(path), f"has a message on channel {record.channel_id}, "
                                     "which it does not describe")  # fmt: skip
            kind = normalized(schemas.get(channel.schema_id, ""))
            encoding = _ENCODINGS.get(channel.message_encoding)
            if encoding is None or not readable(kind, encoding):
                ignored[_note(channel, kind)] = None
                continue
            allowance.take(len(record.data), "a message")
            stamp = min(record.log_time, 2**62)
            yield Message(channel.topic, kind, encoding, stamp, record.data)  # type: ignore[arg-type]
        if len(channels) + len(schemas) > _MOST_CHANNELS:
            raise RecordingError(str(path), f"has more than {_MOST_CHANNELS} channels")
    notes += ignored


def _note(channel: Any, kind: str) -> str:
    what = f"{kind} in {channel.message_encoding}"[:200]
    return f"ignored topic {channel.topic[:200]!r}: messages of type {what} are not read"


def _records(content: Any, allowance: Allowance, notes: list[str]) -> Iterator[Any]:
    """All records, those of chunks among them. A file that ends early is read as far as it goes."""
    from mcap.exceptions import EndOfFile
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    records = StreamReader(content, emit_chunks=True, record_size_limit=len(content)).records
    found = False
    while True:
        try:
            record = next(records)
        except StopIteration:
            return
        except (EndOfFile, struct.error):  # the latter within a record's length
            if not found or content.tell() < len(content):
                raise
            notes.append("the file ends early (was its writer interrupted?); what is there is read")
            return
        if not isinstance(record, Chunk):
            yield record
            continue
        data = unpacked(record.data, record.compression, record.uncompressed_size)
        allowance.take(len(data), "a chunk")
        yield from breakup_chunk(dataclasses.replace(record, compression="", data=data))
        found = True
