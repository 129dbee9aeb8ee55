"""`load_scene`: from whatever a user has to a `Scene`."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orbisim.errors import InputError, SceneError
from orbisim.scene.guard import Limits, guarded
from orbisim.scene.reading import Reader, ReadResult
from orbisim.scene.scene import Scene

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
ARCHIVE_SUFFIXES = (".zip", ".mjz")
SUFFIXES = (".xml", ".mjcf", ".urdf", *USD_SUFFIXES, *ARCHIVE_SUFFIXES)


def load_scene(
    source: str | os.PathLike[str],
    *,
    assets: Mapping[str, bytes] | None = None,
    trusted: bool = False,
    **options: Any,
) -> Scene:
    """Reads a scene.

    Args:
      source: a path to MJCF (`.xml`), URDF, USD (`.usd`, `.usda`, `.usdc`, `.usdz`) or a zip
        archive holding one of them; a task name (`suite:cheetah-run`, `task:push`); or MJCF or
        URDF as a string that starts with `<`.
      assets: for MJCF given as a string, the contents of the files that it refers to.
      trusted: read in this process without first trying in a child with bounded time and
        memory. Faster; a file that crashes the parser takes the process down.
      **options: passed to the reader (see `read_urdf` and `read_usd`).

    Raises:
      SceneError: the scene cannot be read; the message names file and element.
      UnknownNameError: there is no task of that name.
      MissingDependencyError: the format needs an extra that is not installed.
    """
    text = os.fspath(source)
    if text.lstrip()[:1] == "<":
        return _from_string(text, assets, options)
    if assets is not None:
        raise InputError("assets are for MJCF given as a string; a file finds its own")
    prefix, _, task = text.partition(":")
    if task and prefix in ("suite", "task"):
        return _from_task(prefix, task)
    return _from_path(text, trusted, options)


def _from_string(text: str, assets: Mapping[str, bytes] | None, options: dict[str, Any]) -> Scene:
    from orbisim.scene.mjcf import read_mjcf_string

    tag = _root_tag(text)
    if tag == "robot":
        from orbisim.scene.urdf import read_urdf_string

        return Scene.from_read(read_urdf_string(text, **options), "URDF string")
    _no_options(options, "MJCF")
    return Scene.from_read(read_mjcf_string(text, assets), "XML string")


def _from_task(prefix: str, task: str) -> Scene:
    if prefix == "suite":
        from orbisim import suite

        return suite.load_scene(task)
    from orbisim import tasks
    from orbisim.tasks.registry import split

    name, subtask = split(task)
    return tasks.make(f"{prefix}:{name}").scene(subtask)


def _from_path(text: str, trusted: bool, options: dict[str, Any]) -> Scene:
    path = Path(text)
    if path.is_dir():
        raise SceneError(text, "is a folder", remedy="name a scene file inside it")
    if not path.exists():
        raise SceneError(text, "no such file", remedy=_similar_files(path))
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise SceneError(
            text,
            f"a scene has one of the suffixes {', '.join(SUFFIXES)}; got {suffix or 'none'!r}",
            remedy="rename the file if it is one of these formats",
        )
    if path.stat().st_size == 0:
        raise SceneError(text, "the file is empty")
    if suffix in ARCHIVE_SUFFIXES:
        from orbisim.scene.archive import extracted

        with extracted(path) as scene_path:
            scene = _from_path(str(scene_path), trusted, options)
            return scene.replace_source(text)
    reader = _reader(path, suffix)
    if suffix in USD_SUFFIXES:  # the reader itself runs OpenUSD in a process of its own
        return Scene.from_read(reader(text, **options), text)

    def work() -> Scene:
        return Scene.from_read(reader(text, **options), text)

    if not trusted:
        guarded(work, text, Limits().for_input_of(_size_with_references(path)))
    return work()


def _reader(path: Path, suffix: str) -> Reader:
    """The reader for a file, by suffix and root element."""
    if suffix in USD_SUFFIXES:
        from orbisim.scene.usd import read_usd

        return read_usd
    tag = _root_tag(_head(path))
    if tag == "robot":
        if suffix != ".urdf":
            raise SceneError(str(path), "holds URDF (<robot>)", remedy="rename it to end in .urdf")
        from orbisim.scene.urdf import read_urdf

        return read_urdf
    if suffix == ".urdf":
        raise SceneError(
            str(path),
            f"URDF starts with <robot>; got <{tag}>" if tag else "holds no XML element",
            remedy="rename it to end in .xml if it is MJCF",
        )
    return _read_mjcf


def _head(path: Path) -> str:
    """The first characters of a file."""
    with path.open("rb") as file:
        data = file.read(65536)
    marked = data[:2] in (b"\xff\xfe", b"\xfe\xff")
    return data.decode("utf-16" if marked else "utf-8", errors="replace")


def _read_mjcf(path: str, **options: Any) -> ReadResult:
    from orbisim.scene.mjcf import read_mjcf

    _no_options(options, "MJCF")
    return read_mjcf(path)


def _no_options(options: dict[str, Any], what: str) -> None:
    if options:
        raise InputError(f"the {what} reader takes no options; got {', '.join(sorted(options))}")


def _root_tag(text: str) -> str:
    """Name of the first element, skipping comments, declarations and the byte order mark."""
    position = 0
    while (start := text.find("<", position)) >= 0:
        rest = text[start:]
        if rest.startswith("<!--"):
            end = text.find("-->", start)
            if end < 0:
                return ""
            position = end + 3
        elif rest[1:2] in ("?", "!"):
            position = start + 1
        else:
            name = rest[1:200].replace("/", " ").replace(">", " ").split()
            return name[0] if name else ""
    return ""


_REFERENCE = re.compile(r"""(?:file\w*|filename)\s*=\s*["']([^"']+)["']""")
_DIRECTORY = re.compile(r"""(?:meshdir|texturedir|assetdir)\s*=\s*["']([^"']+)["']""")


def _size_with_references(path: Path, seen: set[Path] | None = None) -> int:
    """Bytes in an XML file and in the files that it names, included documents and theirs too."""
    seen = set() if seen is None else seen
    seen.add(path)
    total = path.stat().st_size
    text = path.read_bytes().decode(errors="replace")
    folders = [path.parent, *(path.parent / name for name in _DIRECTORY.findall(text))]
    for name in set(_REFERENCE.findall(text)):
        found = next((f / name for f in folders if _is_file(f / name)), None)
        if found is None or found in seen or len(seen) > 10_000:
            continue
        seen.add(found)
        is_xml = found.suffix.lower() == ".xml"
        total += _size_with_references(found, seen) if is_xml else found.stat().st_size
    return total


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that no file can have
        return False


def _similar_files(path: Path) -> str:
    import difflib

    if not path.parent.is_dir():
        return f"the folder {str(path.parent)!r} does not exist either"
    names = [entry.name for entry in path.parent.iterdir()]
    close = difflib.get_close_matches(path.name, names, n=1)
    return f"did you mean {str(path.parent / close[0])!r}?" if close else "check the path"
