"""Which reader reads a file: by its suffix; a folder: by a file that is in it.

Readers are plug-ins under the entry points `orbisim.recordings`, named by the suffix without its
dot (`csv`), or by the file that marks a folder (`meta/info.json`).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from orbisim import plugins
from orbisim.errors import InputError, MissingDependencyError, RecordingError
from orbisim.recording.formats.log import Log, LogReader, SeveralEpisodes

GROUP = "orbisim.recordings"
_PART = "#"
_PACKAGED = {
    "bag": "ROS bags",
    "db3": "ROS bags",
    "metadata.yaml": "ROS bags",
    "mcap": "MCAP files",
    "h5": "HDF5 logs",
    "hdf5": "HDF5 logs",
}
"""What is read with packages of an extra, as users call it."""


def open_log(path: str | Path) -> Log:
    """What a log holds.

    Args:
      path: of a file or folder; of a folder with several episodes, `folder#3`.

    Raises:
      RecordingError: there is no such file, no reader knows it, or it is damaged.
      MissingDependencyError: the reader's packages are not installed.
    """
    where, part = _split(path)
    name = _format_of(where)
    if part and not where.is_dir():
        raise RecordingError(
            str(where), f"is one episode; {_PART}{part} is for folders that hold several"
        )
    try:
        return _reader(name).read(where, part)
    except RecordingError:
        raise
    except InputError as error:
        raise as_recording_error(where, error) from None
    except (ModuleNotFoundError, MissingDependencyError) as error:
        told = error.cause if isinstance(error, MissingDependencyError) else ""
        raise MissingDependencyError(
            f"{_PACKAGED.get(name, f'recordings {name!r}')} such as {where.name!r}",
            plugins.EXTRAS.get(name, "logs"),
            told or f"no module {error.name!r}",
        ) from error


def episodes_of(path: str | Path) -> Iterator[str]:
    """What stands for each recording of a log: the path itself, or of a folder that holds several
    episodes `folder#0`, `folder#1` and so on.

    Raises:
      RecordingError: see `open_log`.
    """
    where, part = _split(path)
    reader = None if part or not where.is_dir() else _reader(_format_of(where))
    if isinstance(reader, SeveralEpisodes) and (count := reader.count(where)) > 1:
        yield from (f"{path}{_PART}{number}" for number in range(count))
    else:
        yield str(path)


def _reader(name: str) -> LogReader:
    made: LogReader = plugins.load(GROUP, name, "kind of recording")()
    return made


def as_recording_error(path: str | Path, error: InputError) -> RecordingError:
    """The same said of a recording."""
    return RecordingError(str(path), str(error).removeprefix(f"{path}: "))


def _split(path: str | Path) -> tuple[Path, str]:
    """A path and the part of it that is meant."""
    whole = Path(path)
    before, mark, part = str(path).rpartition(_PART)
    try:
        if whole.exists() or not mark or not Path(before).exists():
            return whole, ""
    except (OSError, ValueError):  # a name that no system takes
        return whole, ""
    return Path(before), part


def _format_of(path: Path) -> str:
    """Name of the plug-in."""
    known = plugins.names(GROUP)
    suffixes = sorted(name for name in known if "." not in name)
    try:
        folder, file, there = path.is_dir(), path.is_file(), path.exists()
    except (OSError, ValueError) as error:
        raise RecordingError(str(path), f"cannot be read: {error}") from None
    if folder:
        return _folder_format(path, [name for name in known if "." in name])
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in suffixes:
        listed = ", ".join(f".{name}" for name in suffixes)
        raise RecordingError(
            str(path),
            f"a recording has one of the suffixes {listed}, or is a folder of a ROS 2 bag or of "
            f"LeRobot; got {path.suffix or 'none'!r}",
        )
    if not file:
        raise RecordingError(str(path), "is not a file" if there else "no such file")
    if path.stat().st_size == 0:
        raise RecordingError(str(path), "the file is empty")
    return suffix


def _folder_format(path: Path, markers: list[str]) -> str:
    for marker in sorted(markers):
        if (path / marker).is_file():
            return marker
    listed = " nor ".join(sorted(markers))
    raise RecordingError(
        str(path), f"is not a file, and not a folder that holds a recording: has neither {listed}"
    )
