"""Scenes in zip archives: extracted with care, and kept to themselves.

`mujoco.MjSpec.to_zip` writes such archives (`.zip`, `.mjz`): one XML document and its files.
"""

from __future__ import annotations

import contextlib
import errno
import re
import stat
import time
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath

from orbisim.errors import SceneError
from orbisim.files.temporary import temporary_folder
from orbisim.files.writing import output_errors
from orbisim.scene.safety.confine import confined_to
from orbisim.scene.safety.xmlsafe import without_comments

MAX_ENTRIES = 20_000
"""Far beyond any scene with its meshes and textures; each takes an entry of the disk."""
MAX_BYTES = 2 * 2**30
"""Of all entries together, uncompressed."""
MAX_RATIO = 200
"""Of uncompressed to compressed size, of an archive that is larger than `RATIO_FROM`."""
RATIO_FROM = 64 * 2**20
"""Bytes, uncompressed, that do no harm whatever they were packed to."""
MAX_SECONDS, SECONDS_PER_MEGABYTE = 3.0, 1.0
"""Of the processor, to extract an archive, and for each megabyte that it has. Deflate unpacks some
hundred megabytes a second; bzip2 and LZMA can be made to take hours."""

_CHUNK = 2**20  # bytes between two looks at the budget
_ROOT_TAG = re.compile(rb"<\s*([A-Za-z_][\w:.-]*)")
_ENCRYPTED = 0x1  # bit of an entry's flags in the ZIP format


@contextlib.contextmanager
def extracted(path: str | Path, suffixes: Sequence[str]) -> Iterator[Path]:
    """Extracts an archive to a temporary folder; yields the path of the scene in it.

    Args:
      path: of the archive.
      suffixes: what the names of scenes may end in.

    Within the block references are confined to that folder (see `confine`), and errors name the
    archive instead of it. Afterwards the folder is gone: readers put the files that they need into
    the scene's own assets.

    Raises:
      SceneError: it is no archive, is broken, encrypted, too large, holds a name that leaves the
        folder, or does not say which scene is meant.
    """
    path = Path(path)
    with temporary_folder() as folder:
        try:
            with output_errors(folder):
                names = _extract(path, folder)
            scene = folder / _choose(names, suffixes, folder, path)
            with confined_to(folder):
                yield scene
        except SceneError as error:
            raise _renamed(error, folder, path) from None


def _extract(path: Path, folder: Path) -> list[str]:
    """Writes every entry; returns their names."""
    try:
        with zipfile.ZipFile(path) as archive:
            entries = [entry for entry in archive.infolist() if not entry.is_dir()]
            _check_size(entries, path)
            names = [_safe_name(entry, path) for entry in entries]
            _check_distinct(names, path)
            budget = _Budget(path)
            for entry, name in zip(entries, names, strict=True):
                _write(archive, entry, folder / name, budget)
            return names
    except SceneError:
        raise
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EROFS):  # not the archive's fault
            raise
        raise _unreadable(path, error) from None
    except Exception as error:  # zlib, bz2, lzma and zipfile each have errors of their own
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: Exception) -> SceneError:
    reason = " ".join(str(error).split())[:200] or type(error).__name__
    return SceneError(
        str(path), f"is no archive that can be read: {reason}", remedy="zip the scene again"
    )


def _check_size(entries: list[zipfile.ZipInfo], path: Path) -> None:
    if len(entries) > MAX_ENTRIES:
        raise SceneError(
            str(path), f"holds {len(entries)} files; at most {MAX_ENTRIES} are extracted"
        )
    size = sum(entry.file_size for entry in entries)
    packed = max(path.stat().st_size, 1)
    if size > MAX_BYTES or (size > RATIO_FROM and size > MAX_RATIO * packed):
        raise SceneError(
            str(path),
            f"would extract to {size} bytes from {packed}; at most {MAX_BYTES} and "
            f"{MAX_RATIO} times its size are extracted",
        )


def _safe_name(entry: zipfile.ZipInfo, path: Path) -> str:
    """The name of an entry, relative and inside the folder."""
    name = entry.filename.replace("\\", "/")
    parts = PurePosixPath(name).parts
    kind = stat.S_IFMT(entry.external_attr >> 16)
    if entry.flag_bits & _ENCRYPTED:
        problem = "is encrypted"
    elif kind not in (0, stat.S_IFREG):
        problem = "is a link or a device, not a file"
    elif name.startswith("/") or re.match(r"^[A-Za-z]:", name) or ".." in parts:
        problem = "has a name that leaves the archive"
    elif not parts or any(not part.isprintable() for part in parts):
        problem = "has a name that no file can have"
    else:
        return str(PurePosixPath(*parts))
    raise SceneError(
        str(path), problem, element=f"entry {entry.filename[:200]!r}", remedy="zip the scene again"
    )


def _check_distinct(names: list[str], path: Path) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise SceneError(str(path), "is there twice", element=f"entry {name!r}")
        seen.add(name)


class _Budget:
    """What the entries of an archive may take together.

    Args:
      path: of the archive.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._left = path, MAX_BYTES
        self._seconds = MAX_SECONDS + SECONDS_PER_MEGABYTE * path.stat().st_size / _CHUNK
        self._end = time.thread_time() + self._seconds

    def take(self, nbytes: int) -> None:
        """Counts bytes that are about to be written, and the time so far.

        Raises:
          SceneError: it is too much.
        """
        self._left -= nbytes
        if self._left < 0:
            raise SceneError(str(self._path), f"extracts to more than {MAX_BYTES} bytes")
        if time.thread_time() > self._end:
            problem = f"extracting it took more than {self._seconds:.3g} s"
            raise SceneError(str(self._path), problem, remedy="zip it with deflate")


def _write(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, target: Path, budget: _Budget) -> None:
    """Writes one entry."""
    target.parent.mkdir(parents=True, exist_ok=True)
    budget.take(0)
    with archive.open(entry) as source, target.open("xb") as file:
        while chunk := source.read(_CHUNK):
            budget.take(len(chunk))
            file.write(chunk)


def _choose(names: list[str], suffixes: Sequence[str], folder: Path, path: Path) -> str:
    """The scene among the entries: the only one at the highest level, or the one so named."""
    scenes = [name for name in names if _is_scene(name, suffixes, folder)]
    if not scenes:
        raise SceneError(
            str(path), f"holds no scene; expected a file ending in {', '.join(suffixes)}"
        )
    level = min(len(PurePosixPath(name).parts) for name in scenes)
    scenes = sorted(name for name in scenes if len(PurePosixPath(name).parts) == level)
    for wanted in ("scene", path.stem):
        named = [name for name in scenes if PurePosixPath(name).stem == wanted]
        if len(scenes) > 1 and len(named) == 1:
            return named[0]
    if len(scenes) == 1:
        return scenes[0]
    shown = ", ".join(scenes[:8]) + (", ..." if len(scenes) > 8 else "")
    raise SceneError(
        str(path),
        f"holds {len(scenes)} scenes ({shown})",
        remedy=f"name the one that is meant scene or {path.stem}",
    )


def _is_scene(name: str, suffixes: Sequence[str], folder: Path) -> bool:
    """By suffix; XML also by its root element, for archives hold other XML too."""
    suffix = PurePosixPath(name).suffix.lower()
    if suffix != ".xml":
        return suffix in suffixes
    with (folder / name).open("rb") as file:
        found = _ROOT_TAG.search(without_comments(file.read(65536)))
    return found is None or found[1] in (b"mujoco", b"robot")


def _renamed(error: SceneError, folder: Path, path: Path) -> SceneError:
    """The same error, in terms of the archive."""

    def outside(text: str | None) -> str | None:
        if text is None:
            return None
        for spelling in {str(folder), str(folder.resolve())}:
            text = text.replace(spelling + "/", f"{path}/").replace(spelling, str(path))
        return text

    return type(error)(
        outside(error.source) or str(path),
        outside(error.problem) or "",
        element=outside(error.element),
        remedy=outside(error.remedy),
    )
