"""What a log file holds, before anything is converted or named: `Log`, the result of a reader."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Column:
    """A column of a table, an array, or a field of messages.

    Attributes:
      name: as the file has it.
      shape: of its samples, so far as known before it is read: [T] or [T, n].
      unit: that the format itself states, None if it states none (a unit in the name is not taken
        out of it here).
      signal: the signal that the format itself says it is (of `sensor_msgs/JointState`), or None.
      group: columns of one group were sampled together.
    """

    name: str
    shape: tuple[int, ...] | None = None
    unit: str | None = None
    signal: str | None = None
    group: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
class Log:
    """A log.

    Attributes:
      source: its file or folder.
      columns: what it holds, in its order.
      read: reads columns by name: arrays [T] or [T, n] of numbers (or of `datetime64`, for times).
        Others than numbers come as they are, or raise `RecordingError`.
      clocks: times by group, s, of formats that have clocks of their own.
      table: whether each column is one component, so that vectors take several columns.
      literal: whether the names are those of signals to the letter, as `Recording.save` wrote them.
      header: what `Recording.save` wrote beside the samples.
      notes: what is to be said of the reading.
    """

    source: str
    columns: tuple[Column, ...]
    read: Callable[[Sequence[str]], Mapping[str, Array]]
    clocks: Mapping[str, Floats] = dataclasses.field(default_factory=dict)
    table: bool = False
    literal: bool = False
    header: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(column.name for column in self.columns)


class LogReader(Protocol):
    """Reads one format. A package offers its own under the entry points `orbisim.recordings`."""

    def read(self, path: Path, part: str) -> Log:
        """What a file or folder holds.

        Args:
          path: of the file or folder; it exists.
          part: which of its episodes, for formats that hold several ("3" of `folder#3`); empty if
            none was named.

        Raises:
          RecordingError: it is not of this format, is damaged, or holds more than its size allows.
        """
        ...


@runtime_checkable
class SeveralEpisodes(Protocol):
    """What a `LogReader` has besides if its folders hold several episodes."""

    def count(self, path: Path) -> int:
        """How many, named "0", "1" and so on.

        Raises:
          RecordingError: the folder does not say it.
        """
        ...
