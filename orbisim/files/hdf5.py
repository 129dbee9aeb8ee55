"""HDF5 files from outside: opened here and nowhere else.

HDF5 can do far more than hold numbers: a dataset may stand in another file (external links,
external storage, virtual datasets), run code (filters that are loaded from the system), be linked
from many places, or declare a size that no disk has. A `Reader` follows none of this: it gives
numbers and strings that stand in the file itself, and refuses the rest by name. What the library
itself does not get out of (circles in its own tables) is tried first where it can be ended:
`try_out`.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError, MissingDependencyError, SceneError
from orbisim.files.budget import Limits
from orbisim.files.guard import guarded
from orbisim.files.reading import Allowance, size_of

if TYPE_CHECKING:
    import h5py
else:
    try:
        import h5py
    except ImportError as error:
        raise MissingDependencyError("HDF5 files", "learned", "no module 'h5py'") from error

Array = npt.NDArray[Any]

LIBRARY: str = h5py.version.hdf5_version
"""Its version: what one takes well, another may not."""
_NUMBERS_AND_STRINGS = "biufS"
_MOST_AXES = 8
"""Far beyond anything recorded: images over time have four."""
_MOST_TEXT = 16 * 2**20
"""Bytes of an attribute; the descriptions of collections have some kilobytes."""
_MOST_CHUNKS, _LEAST_CHUNK = 10_000, 1024
"""HDF5 takes 4 KB of memory for each chunk, however small; many small ones are refused."""
_DEEPEST = 16
"""Groups within each other; collections have three."""
_MOST_NAMES = 10_000
"""Below one group; groups may be linked to each other in circles."""
_KEPT = 64
"""Groups that are kept open, so that the way to each dataset is not gone anew."""
_FILTERS = {
    h5py.h5z.FILTER_DEFLATE: "gzip",
    h5py.h5z.FILTER_SHUFFLE: "shuffle",
    h5py.h5z.FILTER_FLETCHER32: "fletcher32",
    h5py.h5z.FILTER_LZF: "lzf",
}
"""Filters that are part of HDF5 or h5py; others are libraries that HDF5 would load."""


def try_out(path: Path, work: Callable[[], object], seconds: float = 1.0) -> None:
    """Does the work in a process that can be ended.

    In some damaged files the HDF5 library goes round in circles, where no exception reaches it.
    An `InputError` of the work itself is left to the caller, who meets it again.

    Args:
      path: the file. work: what is tried.
      seconds: of the processor that it may take, and one more for each megabyte.

    Raises:
      InputError: it took too long or too much memory, or crashed, or raised a `SceneError`.
    """
    try:
        guarded(work, str(path), Limits(seconds=seconds).for_input_of(size_of(path)))
    except SceneError as error:
        raise InputError(f"{path}: cannot be read as HDF5 ({error.problem})") from None


class Reader:
    """Reads groups, datasets and attributes by their place in the file (`episodes/0/qpos`).

    Args:
      path: the file.

    Raises:
      InputError: there is no such file, or it is not HDF5. So do all methods where what is asked
        for is not there, is damaged, or is one of the things that are refused.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.size = size_of(self.path)
        try:
            self._file = h5py.File(self.path, "r")
        except Exception as error:  # h5py passes on what the library says under many types
            raise InputError(f"{path}: not an HDF5 file ({_line(error)})") from None
        self._groups: dict[str, Any] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the file."""
        self._groups.clear()
        with contextlib.suppress(Exception):  # the library may stumble over what is damaged
            self._file.close()

    def allowance(self) -> Allowance:
        """What may be unpacked from this file."""
        return Allowance(self.path, self.size)

    # -- groups --------------------------------------------------------------------------------

    def keys(self, place: str = "") -> list[str]:
        """Names in a group, sorted."""
        group = self._group(place)
        with self._errors(place):
            return sorted(group)

    def datasets(self, place: str = "") -> list[str]:
        """Names of all datasets below a group, relative to it, sorted."""
        found: list[str] = []
        groups, seen = [""], 0
        for prefix in groups:  # which grows
            keys = self.keys(f"{place}/{prefix}".strip("/"))
            seen += len(keys)
            if seen > _MOST_NAMES or prefix.count("/") > _DEEPEST:
                raise self._error(place, f"holds more than {_MOST_NAMES} names, or too deep ones")
            for name in (prefix + key for key in keys):
                item = self._object(f"{place}/{name}".strip("/"))
                if isinstance(item, h5py.Dataset):
                    found.append(name)
                else:
                    groups.append(f"{name}/")
        return sorted(found)

    # -- datasets ------------------------------------------------------------------------------

    def shape(self, place: str) -> tuple[int, ...]:
        """Shape of a dataset."""
        dataset = self._dataset(place)
        with self._errors(place):
            return tuple(int(n) for n in dataset.shape or ())

    def array(self, place: str, allowance: Allowance | None = None) -> Array:
        """A dataset of numbers or of strings of a fixed length.

        Args:
          place: where it stands.
          allowance: what it is counted against; one of its own if None.
        """
        dataset = self._dataset(place)
        nbytes = self._checked(dataset, place)
        (allowance or self.allowance()).take(nbytes, place)
        self._check_chunks(dataset, place, nbytes)
        with self._errors(place):
            return np.asarray(dataset[()])

    def _checked(self, dataset: Any, place: str) -> int:
        """Bytes that a dataset declares, if it may be read."""
        with self._errors(place):
            virtual, external = dataset.is_virtual, dataset.external
            shape, kind = dataset.shape, dataset.dtype
            used = _filters(dataset)
        if virtual or external:
            raise self._error(place, "its numbers stand in another file, which is not followed")
        if unknown := sorted(used - _FILTERS.keys()):
            known = ", ".join(_FILTERS.values())
            raise self._error(place, f"is packed by filter {unknown[0]}; known are {known}")
        if shape is None or kind.kind not in _NUMBERS_AND_STRINGS:
            raise self._error(place, f"expected numbers or strings of fixed length; got {kind}")
        if len(shape) > _MOST_AXES:
            raise self._error(place, f"has {len(shape)} axes; at most {_MOST_AXES} are read")
        return math.prod(map(int, shape)) * int(kind.itemsize)

    def _check_chunks(self, dataset: Any, place: str, nbytes: int) -> None:
        with self._errors(place):
            shape, chunks = dataset.shape, dataset.chunks
        if chunks is None:
            return
        count = math.prod(-(-n // c) for n, c in zip(shape, chunks, strict=True))
        if count > _MOST_CHUNKS and nbytes < _LEAST_CHUNK * count:
            raise self._error(place, f"is cut into {count} chunks of a few bytes")

    # -- attributes ----------------------------------------------------------------------------

    def attribute(self, place: str, name: str) -> Any:
        """A number, a truth value or a string; None where there is none of that name."""
        item = self._object(place)
        with self._errors(place, name):
            if name not in item.attrs:
                return None
            identity = item.attrs.get_id(name)
            if identity.shape != () or identity.get_storage_size() > _MOST_TEXT:
                raise self._error(place, "expected one number or one string", name)
            value = item.attrs[name]
            value = value.item() if isinstance(value, np.generic) else value
            value = value.decode() if isinstance(value, bytes) else value
        if not isinstance(value, (bool, int, float, str)):
            raise self._error(place, f"expected a number or a string; got {type(value)}", name)
        return value

    def text(self, place: str, name: str) -> str:
        """An attribute that is a string."""
        value = self.attribute(place, name)
        if not isinstance(value, str):
            raise self._error(place, f"expected a string; got {value!r}", name)
        return value

    def number(self, place: str, name: str) -> float:
        """An attribute that is a finite number."""
        value = self.attribute(place, name)
        if isinstance(value, str) or value is None or not math.isfinite(value):
            raise self._error(place, f"expected a number; got {value!r}", name)
        return float(value)

    def integer(self, place: str, name: str) -> int:
        """An attribute that is a whole number."""
        value = self.number(place, name)
        if value != int(value):
            raise self._error(place, f"expected a whole number; got {value!r}", name)
        return int(self.attribute(place, name))

    def parsed(self, place: str, name: str) -> Any:
        """An attribute that is JSON."""
        try:
            return json.loads(self.text(place, name))
        except (ValueError, RecursionError) as error:
            raise self._error(place, f"is not JSON ({_line(error)})", name) from None

    # -- inner workings ------------------------------------------------------------------------

    def _group(self, place: str, asked: str | None = None) -> Any:
        found = self._object(place, asked)
        if not isinstance(found, h5py.Group):
            raise self._error(place, "expected a group")
        return found

    def _dataset(self, place: str) -> Any:
        found = self._object(place)
        if not isinstance(found, h5py.Dataset):
            raise self._error(place, "expected a dataset")
        return found

    def _object(self, place: str, asked: str | None = None) -> Any:
        """What stands there; every link on the way stays in the file.

        Args:
          place: where. asked: the place below it that is looked for, for messages.
        """
        if not place:
            return self._file
        if place in self._groups:
            return self._groups[place]
        above, _, name = place.rpartition("/")
        group = self._group(above, asked or place)
        with self._errors(place):
            if name in ("", ".") or name not in group:
                raise InputError(f"{self.path}: has no {asked or place!r}")
            link = group.get(name, getlink=True)
            if not isinstance(link, h5py.HardLink):
                raise self._error(place, "is a link to elsewhere, which is not followed")
            found = group[name]
        if isinstance(found, h5py.Group):
            if len(self._groups) >= _KEPT:
                self._groups.clear()
            self._groups[place] = found
        return found

    @contextlib.contextmanager
    def _errors(self, place: str, attribute: str = "") -> Iterator[None]:
        try:
            yield
        except InputError:
            raise
        except Exception as error:  # as above: of a damaged file, the library raises anything
            raise self._error(place, f"is damaged ({_line(error)})", attribute) from None

    def _error(self, place: str, problem: str, attribute: str = "") -> InputError:
        where = f"attribute {attribute!r} of " if attribute else ""
        return InputError(f"{self.path}: {where}{place or 'the file'} {problem}")


def _filters(dataset: Any) -> set[int]:
    plist = dataset.id.get_create_plist()
    return {plist.get_filter(i)[0] for i in range(plist.get_nfilters())}


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
