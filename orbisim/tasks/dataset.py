"""`EpisodeFile`: reads episodes; needs NumPy and h5py only."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError, SceneError
from orbisim.files.checked import digest_of, key_of, recall, remember
from orbisim.files.hdf5 import LIBRARY, Reader, try_out
from orbisim.files.reading import Allowance, size_of
from orbisim.tasks.schema import PER_STEP, SCHEMA, is_static

Array = npt.NDArray[Any]
_SECONDS = 4.0
"""Of the processor, and one more for each megabyte: episodes of few numbers take a fifth of it."""


@dataclasses.dataclass(frozen=True, eq=False)
class Stacked:
    """Episodes after one another, padded with zeros to the largest shape.

    Attributes:
      arrays: by name, [episodes, ...largest shape among them].
      masks: by name, the same shape without the last axis (vectors) or as it is (scalars over
        time): True where the entry is data and not padding.
      lengths: [episodes] number of control steps T.
    """

    arrays: dict[str, Array]
    masks: dict[str, npt.NDArray[np.bool_]]
    lengths: npt.NDArray[np.int64]


class EpisodeFile:
    """Episodes in an HDF5 file, read when they are asked for.

    A file whose content was not seen before is first read through in a child process, with bounds
    on processor time and memory.

    Args:
      path: the file.
      trusted: leave that out.

    Attributes:
      task, seed, control_timestep, timestep: of the collection; the last two in s.
      versions: of the software that made it.

    Raises:
      InputError: there is no such file, it is not one of episodes, it is not complete, or it is
        damaged. So do all methods.
    """

    def __init__(self, path: str | Path, *, trusted: bool = False) -> None:
        self.path = Path(path)
        if not trusted:
            _try_out(self.path)
        self._file = Reader(self.path)
        try:
            self._check()
            self.task = self._file.text("", "task")
            self.seed = self._file.integer("", "seed")
            self.control_timestep = self._file.number("", "control_timestep")
            self.timestep = self._file.number("", "timestep")
            self.versions: dict[str, str] = self._object("versions")
            self.config: dict[str, Any] = self._object("config")
            self._keys = self._file.keys("episodes")
        except InputError:
            self._file.close()
            raise

    def _check(self) -> None:
        schema = self._file.attribute("", "schema")
        if schema != SCHEMA:
            raise InputError(f"{self.path}: schema is {schema!r}; expected {SCHEMA!r}")
        if not self._file.attribute("", "complete"):
            raise InputError(
                f"{self.path}: the collection was not finished; run the same command again"
            )

    def _object(self, name: str) -> dict[str, Any]:
        value = self._file.parsed("", name)
        if not isinstance(value, dict):
            raise InputError(f"{self.path}: attribute {name!r} is not a JSON object")
        return value

    def __len__(self) -> int:
        return len(self._keys)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the file."""
        self._file.close()

    def names(self, index: int = 0) -> tuple[str, ...]:
        """Names of the datasets of an episode."""
        return tuple(self._file.datasets(self._place(index)))

    def attributes(self, index: int) -> dict[str, Any]:
        """`subtask`, `seed`, `scene_hash` and `success` (None where there is no measure)."""
        place = self._place(index)
        known = self._file.attribute(place, "success") is not None
        success = self._file.integer(place, "success") if known else -1
        return {
            "subtask": self._file.text(place, "subtask"),
            "seed": self._file.integer(place, "seed"),
            "scene_hash": self._file.text(place, "scene_hash"),
            "success": None if success < 0 else bool(success),
        }

    def allowance(self) -> Allowance:
        """What a reader may unpack from this file, if it keeps it (see `episode`)."""
        return self._file.allowance()

    def episode(
        self, index: int, names: Iterable[str] | None = None, allowance: Allowance | None = None
    ) -> dict[str, Array]:
        """Datasets of one episode by name; all of them unless some are asked for.

        Args:
          index: which episode.
          names: of the datasets.
          allowance: what they are counted against, for readers that keep many episodes.

        Raises:
          InputError: the episode has no dataset of a name, or one that runs over time has another
            number of rows than the episode has steps.
        """
        place = self._place(index)
        wanted = self.names(index) if names is None else names
        steps, allowance = self._steps(index), allowance or self.allowance()
        return {name: self._read(place, name, steps, allowance) for name in wanted}

    def columns(self, name: str, index: int = 0) -> tuple[str, ...]:
        """Names of the columns of a descriptor dataset (`descriptor/objects`)."""
        place = f"{self._place(index)}/{name}"
        columns = self._file.parsed(place, "columns")
        if not (isinstance(columns, list) and all(isinstance(one, str) for one in columns)):
            raise InputError(f"{self.path}: columns of {place} are not a list of names")
        return tuple(columns)

    def entities(self, index: int) -> tuple[str, ...]:
        """Names of the entities; the robot first, if there is one."""
        place = f"{self._place(index)}/entities/names"
        names = self._file.array(place)
        if names.ndim != 1 or names.dtype.kind != "S":
            raise InputError(f"{self.path}: {place} is not a list of names")
        return tuple(name.decode(errors="replace") for name in names.tolist())

    def select(self, subtask: str) -> list[int]:
        """Indices of the episodes of a subtask."""
        places = (self._place(index) for index in range(len(self)))
        return [i for i, place in enumerate(places) if self._file.text(place, "subtask") == subtask]

    def __iter__(self) -> Iterator[dict[str, Array]]:
        for index in range(len(self)):
            yield self.episode(index)

    def stack(self, names: Sequence[str], indices: Sequence[int] | None = None) -> Stacked:
        """Episodes as padded arrays with masks.

        Args:
          names: datasets.
          indices: which episodes; all of them if None.
        """
        chosen = range(len(self)) if indices is None else indices
        allowance = self.allowance()
        rows = [self.episode(index, names, allowance) for index in chosen]
        lengths = np.array([self._steps(index) for index in chosen], np.int64)
        arrays, masks = {}, {}
        for name in names:
            arrays[name], masks[name] = _pad([row[name] for row in rows])
        return Stacked(arrays, masks, lengths)

    def lengths(self) -> list[int]:
        """Number of control steps T of every episode."""
        return [self._steps(index) for index in range(len(self))]

    def _steps(self, index: int) -> int:
        place = f"{self._place(index)}/time"
        shape = self._file.shape(place)
        if len(shape) != 1 or not shape[0]:
            raise InputError(f"{self.path}: {place} has shape {shape}; expected one axis, [T+1]")
        return shape[0] - 1

    def _place(self, index: int) -> str:
        if not -len(self) <= index < len(self):
            raise InputError(f"{self.path}: has {len(self)} episodes; there is none of {index}")
        return f"episodes/{self._keys[index]}"

    def _read(self, place: str, name: str, steps: int, allowance: Allowance) -> Array:
        shape = self._file.shape(f"{place}/{name}")
        expected = steps if name in PER_STEP else steps + 1
        if not is_static(name) and shape[:1] != (expected,):
            raise InputError(
                f"{self.path}: {place}/{name} has shape {shape}; an episode of {steps} steps "
                f"has {expected} rows of it"
            )
        return self._file.array(f"{place}/{name}", allowance)


def vouch_for(path: Path) -> None:
    """Says of a file that this process has just written that its content need not be tried."""
    remember(_key(path), {})


def _try_out(path: Path) -> None:
    """Reads a file where it can do no harm, unless its content came through before.

    Raises:
      InputError: the child was ended, or crashed.
    """
    size_of(path)
    try:
        key = _key(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    if recall(key) is None:
        try_out(path, lambda: _read_all(path), _SECONDS)
        remember(key, {})


def _key(path: Path) -> str:
    return key_of("hdf5", LIBRARY, digest_of(path))


def _read_all(path: Path) -> None:
    """All that the methods of `EpisodeFile` read."""
    with EpisodeFile(path, trusted=True) as file:
        for index in range(len(file)):
            try:
                names = file.names(index)
            except InputError as error:  # else nobody knows what else there is to be tried
                raise SceneError(str(path), str(error).removeprefix(f"{path}: ")) from None
            _without_errors(file.attributes, index)
            if not _without_errors(file.episode, index, names):
                for name in names:  # those that are in order can be asked for by name
                    _without_errors(file.episode, index, [name])
            for name in names:
                _without_errors(file.columns, name, index)


def _without_errors(method: Callable[..., object], *args: object) -> bool:
    """Whether it went well; whoever asks for what did not meets the error again."""
    try:
        method(*args)
    except InputError:
        return False
    return True


def _pad(arrays: Sequence[Array]) -> tuple[Array, npt.NDArray[np.bool_]]:
    ranks = {array.ndim for array in arrays}
    if len(ranks) > 1:
        raise InputError("datasets of one name have different numbers of axes")
    shape = tuple(max(sizes) for sizes in zip(*(a.shape for a in arrays), strict=True))
    values = np.zeros((len(arrays), *shape), arrays[0].dtype)
    mask = np.zeros((len(arrays), *shape), bool)
    for row, array in enumerate(arrays):
        inside = tuple(slice(size) for size in array.shape)
        values[row][inside] = array
        mask[row][inside] = True
    if len(shape) < 2:
        return values, mask
    return values, np.asarray(mask.any(axis=-1), bool)
