"""`.db3`, and folders of ROS 2 bags (`metadata.yaml` beside `.db3` or `.mcap` files)."""

from __future__ import annotations

import contextlib
import re
import sqlite3
import tempfile
from collections.abc import Iterator
from pathlib import Path

from orbisim.errors import RecordingError
from orbisim.files.reading import Allowance, size_of
from orbisim.recording.formats.log import Log
from orbisim.recording.formats.mcap import list_messages
from orbisim.recording.formats.messages import Message, damaged, log_of, normalized, readable
from orbisim.recording.formats.unpacking import unpacked

_ZSTD = b"\x28\xb5\x2f\xfd"
"""Begins what is packed by zstandard; no CDR message begins so."""
_SUFFIXES = (".db3", ".mcap")
_STEPS = 10_000
"""Steps of SQLite's machine between two looks at how many there were."""
_MOST_STEPS_A_BYTE = 50
"""Steps for each byte of the file; reading a message takes about a hundred."""
_LEAST_STEPS = 10**7
"""Steps that any file may take: less than a second."""
_LONGEST = 2**30
"""Bytes of a row."""


class Rosbag2Reader:
    """Reads bags of ROS 2: files of SQLite, or folders."""

    def read(self, path: Path, part: str = "") -> Log:
        """The messages of a bag. Of a folder, all its files are one recording."""
        files = [path] if path.is_file() else _files(path)
        if part:
            raise RecordingError(str(path), f"is one episode; it has no part {part!r}")
        allowance = Allowance(path, sum(map(size_of, files)))
        notes: list[str] = []
        found: list[Message] = []
        with damaged(str(path)):
            for file in files:
                found += _messages(file, allowance, notes)
            return log_of(str(path), found, allowance, list(dict.fromkeys(notes)))


def _files(folder: Path) -> list[Path]:
    """The files of a bag, in the order of their numbers."""
    found = [p for p in folder.iterdir() if p.name.removesuffix(".zstd").endswith(_SUFFIXES)]
    if not found:
        raise RecordingError(str(folder), "has a metadata.yaml, but no .db3 or .mcap files")
    return sorted(found, key=lambda p: [int(n) for n in re.findall(r"\d{1,9}", p.name)] or [0])


def _messages(path: Path, allowance: Allowance, notes: list[str]) -> list[Message]:
    if path.suffix != ".zstd":
        return _of_file(path, path.suffix, allowance, notes)
    data = unpacked(path.read_bytes(), "zstd")
    allowance.take(len(data), path.name)
    with tempfile.NamedTemporaryFile(suffix=path.with_suffix("").suffix) as whole:
        whole.write(data)
        whole.flush()
        return _of_file(Path(whole.name), path.with_suffix("").suffix, allowance, notes)


def _of_file(path: Path, suffix: str, allowance: Allowance, notes: list[str]) -> list[Message]:
    if suffix == ".mcap":
        return list_messages(path, allowance, notes)
    with _database(path) as database:
        return list(_rows(database, allowance, notes))


@contextlib.contextmanager
def _database(path: Path) -> Iterator[sqlite3.Connection]:
    """A file of SQLite, which is not written, and in which nothing is computed for long."""
    uri = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
    most = max(_LEAST_STEPS, _MOST_STEPS_A_BYTE * size_of(path))
    steps = 0

    def count() -> bool:
        nonlocal steps
        steps += _STEPS
        return steps > most

    with contextlib.closing(sqlite3.connect(uri, uri=True)) as database:
        database.set_progress_handler(count, _STEPS)
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST)
        database.execute("PRAGMA trusted_schema = OFF")
        database.execute("PRAGMA cell_size_check = ON")
        kinds = dict(database.execute("SELECT name, type FROM sqlite_master").fetchall())
        for table in ("topics", "messages"):
            if kinds.get(table) != "table":
                raise ValueError(f"it has no table {table!r}")
        yield database


def _rows(
    database: sqlite3.Connection, allowance: Allowance, notes: list[str]
) -> Iterator[Message]:
    topics = database.execute("SELECT id, name, type, serialization_format FROM topics")
    for number, name, kind, encoding in topics.fetchall():
        topic, kind = str(name), normalized(str(kind))
        if not readable(kind, str(encoding)) or encoding == "ros1":
            text = f"messages of type {kind} in {encoding} are not read"
            notes.append(f"ignored topic {topic[:200]!r}: {text[:200]}")
            continue
        chosen = "SELECT timestamp, data FROM messages WHERE topic_id = ? ORDER BY timestamp"
        for stamp, data in database.execute(chosen, (number,)):
            if not isinstance(data, bytes) or not isinstance(stamp, int):
                raise ValueError(f"a message of {topic[:200]!r} is no bytes with a time")
            plain = unpacked(data, "zstd") if data.startswith(_ZSTD) else data
            allowance.take(len(plain), "a message")
            yield Message(topic, kind, "cdr", stamp, plain)
