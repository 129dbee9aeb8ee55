"""`EpisodeFile`: reads episodes; needs NumPy and h5py only."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError, MissingDependencyError
from orbisim.tasks.schema import SCHEMA

if TYPE_CHECKING:
    import h5py
else:
    try:
        import h5py
    except ImportError as error:
        raise MissingDependencyError("episode files", "learned", "no module 'h5py'") from error

Array = npt.NDArray[Any]


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

    Args:
      path: the file.

    Attributes:
      task, seed, control_timestep, timestep: of the collection; the last two in s.
      versions: of the software that made it.

    Raises:
      InputError: there is no such file, it is not one of episodes, or it is not complete.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if not self.path.exists():
            raise InputError(f"{path}: no such file")
        try:
            self._file = h5py.File(self.path, "r")
        except OSError as error:
            raise InputError(f"{path}: not an HDF5 file ({error})") from None
        try:
            self._check()
        except InputError:
            self._file.close()
            raise
        attributes = self._file.attrs
        self.task = str(attributes["task"])
        self.seed = int(attributes["seed"])
        self.control_timestep = float(attributes["control_timestep"])
        self.timestep = float(attributes["timestep"])
        self.versions: dict[str, str] = json.loads(attributes["versions"])
        self.config: dict[str, Any] = json.loads(attributes["config"])
        self._keys = sorted(self._file["episodes"])

    def _check(self) -> None:
        schema = self._file.attrs.get("schema")
        if schema != SCHEMA:
            raise InputError(f"{self.path}: schema is {schema!r}; expected {SCHEMA!r}")
        if not self._file.attrs.get("complete", False):
            raise InputError(
                f"{self.path}: the collection was not finished; run the same command again"
            )

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
        found: list[str] = []
        self._group(index).visititems(
            lambda name, item: found.append(name) if isinstance(item, h5py.Dataset) else None
        )
        return tuple(sorted(found))

    def attributes(self, index: int) -> dict[str, Any]:
        """`subtask`, `seed`, `scene_hash` and `success` (None where there is no measure)."""
        values = dict(self._group(index).attrs)
        success = int(values.pop("success", -1))
        return {
            "subtask": str(values["subtask"]),
            "seed": int(values["seed"]),
            "scene_hash": str(values["scene_hash"]),
            "success": None if success < 0 else bool(success),
        }

    def episode(self, index: int, names: Iterable[str] | None = None) -> dict[str, Array]:
        """Datasets of one episode by name; all of them unless some are asked for.

        Raises:
          InputError: the episode has no dataset of a name.
        """
        group = self._group(index)
        wanted = self.names(index) if names is None else names
        return {name: self._read(group, name) for name in wanted}

    def columns(self, name: str, index: int = 0) -> tuple[str, ...]:
        """Names of the columns of a descriptor dataset (`descriptor/objects`)."""
        text = self._group(index)[name].attrs["columns"]
        return tuple(json.loads(text))

    def entities(self, index: int) -> tuple[str, ...]:
        """Names of the entities; the robot first, if there is one."""
        return tuple(name.decode() for name in self._group(index)["entities/names"][()])

    def select(self, subtask: str) -> list[int]:
        """Indices of the episodes of a subtask."""
        return [
            i for i, key in enumerate(self._keys) if self._episodes[key].attrs["subtask"] == subtask
        ]

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
        rows = [self.episode(index, names) for index in chosen]
        lengths = np.array([self._steps(index) for index in chosen], np.int64)
        arrays, masks = {}, {}
        for name in names:
            arrays[name], masks[name] = _pad([row[name] for row in rows])
        return Stacked(arrays, masks, lengths)

    def lengths(self) -> list[int]:
        """Number of control steps T of every episode."""
        return [self._steps(index) for index in range(len(self))]

    @property
    def _episodes(self) -> Any:
        return self._file["episodes"]

    def _steps(self, index: int) -> int:
        return int(self._group(index)["time"].shape[0]) - 1

    def _group(self, index: int) -> Any:
        if not -len(self) <= index < len(self):
            raise InputError(f"{self.path}: has {len(self)} episodes; there is none of {index}")
        return self._episodes[self._keys[index]]

    def _read(self, group: Any, name: str) -> Array:
        if name not in group:
            raise InputError(f"{self.path}: {group.name} has no dataset {name!r}")
        return np.asarray(group[name][()])


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
