"""`Recording`: one episode measured on hardware, or taken from any simulator."""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.errors import RecordingError
from orbisim.recording import files, names
from orbisim.recording.contents import Contents
from orbisim.recording.formats.registry import episodes_of
from orbisim.recording.mapping import SignalMap
from orbisim.recording.windows import cut

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Recording(Contents):
    """Samples of named signals over time, checked. Never modified.

    Units are SI and radians, quaternions are w x y z, NaN marks a missing sample, and a control is
    held from its sample to the next. See `orbisim.recording.names` for the names.

    Attributes:
      time: [T], s, strictly increasing, need not be uniform.
      signals: [T] or [T, n] by name.
      units: units of signals, where the source states them; `bind` refuses those that are not SI.
      metadata: whatever else the source says (JSON values).
      source: where it came from, for messages.
      notes: what was ignored or assumed when it was read.
      columns: of the file that it was read from, those that were not used.
      map_file: which said which column is which signal, if one did.
    """

    def __post_init__(self) -> None:
        time = _frozen(_as_floats(self.time, "time", self.source))
        _check_time(time, self.source)
        checked = {
            name: _frozen(_as_signal(name, values, len(time), self.source))
            for name, values in self.signals.items()
        }
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "signals", types.MappingProxyType(checked))
        object.__setattr__(self, "units", types.MappingProxyType(dict(self.units)))
        object.__setattr__(self, "metadata", types.MappingProxyType(dict(self.metadata)))

    def __len__(self) -> int:
        return len(self.time)

    def __eq__(self, other: object) -> bool:
        """Whether the samples are the same (NaN equals NaN); source, units and notes may differ."""
        if not isinstance(other, Recording):
            return NotImplemented
        return (
            self.signals.keys() == other.signals.keys()
            and np.array_equal(self.time, other.time)
            and all(
                np.array_equal(values, other.signals[name], equal_nan=True)
                for name, values in self.signals.items()
            )
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return (
            f"Recording({self.source!r}, {len(self)} samples over {self.duration:.6g} s: "
            f"{', '.join(sorted(self.signals))})"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        plain = (self.time, dict(self.signals), dict(self.units), dict(self.metadata))
        return (Recording, (*plain, self.source, self.notes, self.columns, self.map_file))

    @property
    def duration(self) -> float:
        """From the first to the last sample, s."""
        return float(self.time[-1] - self.time[0])

    # -- files -------------------------------------------------------------------------------------

    @classmethod
    def load(cls, path: str | Path, mapping: str | Path | SignalMap | None = None) -> Recording:
        """Reads a log: `.npz`, `.csv`, `.parquet`, HDF5, ROS bags, MCAP, LeRobot folders.

        Nothing in the file is executed. Units that a header or the format names are converted.

        Args:
          path: of a file or folder; of a folder of several episodes, `folder#3`.
          mapping: a `map.yaml`, or what was read from one: which column is which signal.

        Raises:
          RecordingError: the file is not a recording; the message says what is wrong and where.
          MissingDependencyError: its format needs packages that are not installed.
        """
        read = files.load(path, mapping)
        return cls(**{f.name: getattr(read, f.name) for f in dataclasses.fields(read)})

    def save(self, path: str | Path) -> None:
        """Writes `.npz`, `.csv` or `.parquet`; `.csv` holds no units and no metadata.

        Raises:
          RecordingError: the suffix is none of these.
        """
        files.save(self, Path(path))

    # -- other recordings made from this one -------------------------------------------------------

    def replace(self, **changes: Any) -> Recording:
        """A copy with some fields replaced."""
        return dataclasses.replace(self, **changes)

    def rows(self, index: slice | npt.NDArray[Any]) -> Recording:
        """The chosen samples, in order."""
        return self.replace(
            time=self.time[index], signals={name: v[index] for name, v in self.signals.items()}
        )

    def between(self, start: float, stop: float) -> Recording:
        """The samples with start <= time <= stop."""
        return self.rows((self.time >= start) & (self.time <= stop))

    def windows(self, duration: float) -> list[Recording]:
        """Consecutive pieces of a duration (see `orbisim.recording.windows.cut`)."""
        return [self.rows(slice(w.start, w.stop)) for w in cut(self.time, duration)]

    def select(self, wanted: Iterable[str] | Callable[[str], bool]) -> Recording:
        """The signals with these names, or those for whose name the function is true.

        Raises:
          RecordingError: a name is not recorded.
        """
        if callable(wanted):
            return self.replace(signals={n: v for n, v in self.signals.items() if wanted(n)})
        return self.replace(signals={name: self[name] for name in wanted})

    def without(self, *unwanted: str) -> Recording:
        """All signals but these.

        Raises:
          RecordingError: a name is not recorded.
        """
        gone = {name for name in unwanted if self[name] is not None}
        return self.select(lambda name: name not in gone)

    def __getitem__(self, name: str) -> Floats:
        """The samples of a signal.

        Raises:
          RecordingError: it is not recorded.
        """
        if name not in self.signals:
            known = ", ".join(sorted(self.signals)) or "nothing"
            raise RecordingError(self.source, f"{name!r} is not recorded; recorded: {known}")
        return self.signals[name]


def load_recordings(
    paths: Iterable[str | Path], mapping: str | Path | None = None
) -> list[Recording]:
    """Reads several logs with one map; of a folder of LeRobot all episodes.

    Raises:
      RecordingError, MissingDependencyError: see `Recording.load`.
    """
    chosen = None if mapping is None else SignalMap.load(mapping)
    return [Recording.load(one, chosen) for path in paths for one in episodes_of(path)]


def common_map(recordings: Iterable[Recording]) -> str | None:
    """The map by which all of them were read; None if there is none or several."""
    found = {one.map_file for one in recordings}
    return found.pop() if len(found) == 1 else None


def _frozen(array: Floats) -> Floats:
    """An array that cannot be written; a copy if somebody else could write into it."""
    if array.flags.writeable:
        array = array.copy()
        array.flags.writeable = False
    return array


def _as_floats(values: npt.ArrayLike, name: str, source: str) -> Floats:
    array = np.asarray(values)
    if array.dtype.kind not in "fiub":
        raise RecordingError(source, f"must hold numbers; got {array.dtype}", element=repr(name))
    return np.asarray(array, np.float64)


def _check_time(time: Floats, source: str) -> None:
    """Raises `RecordingError` unless time is a finite, strictly increasing vector."""

    def fail(problem: str, remedy: str) -> None:
        raise RecordingError(source, problem, element="'time'", remedy=remedy)

    if time.ndim != 1:
        fail(f"must be a vector [T]; got shape {time.shape}", "give one time for each sample")
    if not len(time):
        fail("has no samples", "a recording needs at least one")
    bad = np.flatnonzero(~np.isfinite(time))
    if bad.size:
        fail(f"row {bad[0]} is {time[bad[0]]}", "every sample needs its time; remove the row")
    back = np.flatnonzero(np.diff(time) <= 0)
    if back.size:
        row = int(back[0]) + 1
        fail(
            f"must strictly increase; row {row} is {float(time[row])!r} after "
            f"{float(time[row - 1])!r}, and so are {back.size} rows in all",
            "sort the rows and remove repeated ones",
        )


def _as_signal(name: str, values: npt.ArrayLike, count: int, source: str) -> Floats:
    """The samples as [T] (named) or [T, n]."""
    if not names.is_signal(name):
        raise RecordingError(source, "is not the name of a signal", element=repr(name))
    array = _as_floats(values, name, source)
    if array.ndim not in (1, 2) or len(array) != count:
        raise RecordingError(
            source,
            f"needs a row for each of the {count} times; got shape {array.shape}",
            element=repr(name),
        )
    infinite = np.flatnonzero(np.isinf(array.reshape(count, -1)).any(axis=1))
    if infinite.size:
        raise RecordingError(
            source,
            f"row {infinite[0]} is infinite",
            element=repr(name),
            remedy="mark missing samples by NaN",
        )
    if name in names.WHOLE:
        return array.reshape(count, -1) if array.ndim == 1 else array
    return array[:, 0] if array.ndim == 2 and array.shape[1] == 1 else array
