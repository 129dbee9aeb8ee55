"""`load_scene`: from whatever a user has to a `Scene`."""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orbisim import plugins
from orbisim.errors import InputError, SceneError
from orbisim.files.budget import Limits
from orbisim.files.guard import READING, guarded
from orbisim.files.reading import size_of
from orbisim.host.progress import patient
from orbisim.scene.mjcf import MjcfReader
from orbisim.scene.objects import SceneSource, assets_of, scene_of, text_of
from orbisim.scene.paths import path_of, refuse_other_kinds
from orbisim.scene.query import without_options
from orbisim.scene.readers import reader_of_root, reader_of_suffix, suffixes
from orbisim.scene.reading import Reader
from orbisim.scene.safety.archive import extracted
from orbisim.scene.safety.passed import Candidate
from orbisim.scene.scene import Scene

ARCHIVE_SUFFIXES = (".zip", ".mjz")
MOST_DOCUMENT = 256 * 2**20
"""Bytes of an XML document; one with all its meshes written out has some tens of megabytes."""
NAMES = "orbisim.scenes"
"""Entry point group of functions that make a scene of a name (`cheetah-run`), by its prefix."""


def load_scene(
    source: SceneSource,
    *,
    assets: Mapping[str, bytes | str] | None = None,
    trusted: bool = False,
    **options: Any,
) -> Scene:
    """Reads a scene.

    Args:
      source: a path to MJCF (`.xml`), URDF, USD (`.usd`, `.usda`, `.usdc`, `.usdz`), another format
        that a plug-in reads, or a zip archive holding one of them, each with options of its reader
        behind it if need be (`robot.urdf?actuators=position`); a task name
        (`suite:cheetah-run`, `task:push`); a document (MJCF, URDF) as text or bytes that start
        with `<`; a `Scene`, which is returned as it is; an `MjSpec` or `MjModel`; or an element of
        `dm_control.mjcf`, whose whole model is taken with its assets.
      assets: for MJCF given as a string, the contents of the files that it refers to.
      trusted: read in this process without first trying in a child with bounded time and
        memory. Faster; a file that crashes the parser takes the process down.
      **options: passed to the reader (see `read_urdf` and `read_usd`).

    Raises:
      SceneError: the scene cannot be read; the message names file and element.
      UnknownNameError: there is no task of that name.
      MissingDependencyError: the format needs an extra that is not installed.
    """
    if (scene := scene_of(source)) is not None:
        _nothing_else(source, assets, options)
        return scene
    text = text_of(source)
    if text.lstrip("\ufeff \t\r\n")[:1] == "<":
        return _from_string(text.lstrip("\ufeff"), assets_of(assets), trusted, options)
    if assets is not None:
        raise InputError("assets are for MJCF given as a string; a file finds its own")
    if is_scene_name(text):
        with patient(f"loading {text}"):
            return named_scene(text)
    path, chosen = without_options(path_of(text))
    with patient(f"reading {path}"):
        scene = _from_path(path, trusted, {**chosen, **options})
    return scene.replace_source(path_of(text)) if chosen else scene


def _nothing_else(source: object, assets: object, options: Mapping[str, Any]) -> None:
    given = [*options, *(["assets"] if assets is not None else [])]
    if given:
        raise InputError(
            f"a {type(source).__name__} is a scene already; {', '.join(sorted(given))} cannot "
            "change how it is read"
        )


def is_scene_name(text: str) -> bool:
    """Whether a text names a scene (`task:push`), rather than a file or a document."""
    prefix, _, name = text.partition(":")
    return bool(name) and prefix in plugins.names(NAMES)


def named_scene(text: str, source: str = "") -> Scene:
    """A scene by name; never a file or a document.

    For names that stand in data: a path there must not have a file opened.

    Args:
      text: the name.
      source: where it stands; named in errors.

    Raises:
      InputError: it is not the name of a scene.
      UnknownNameError: there is no such task.
    """
    if not is_scene_name(text):
        where = f"{source}: " if source else ""
        known = ", ".join(f"{prefix}:" for prefix in sorted(plugins.names(NAMES)))
        told = f"names begin with {known}" if known else "no package that knows names is installed"
        raise InputError(
            f"{where}expected the name of a scene, such as task:push; got {text!r:.80} ({told})"
        )
    prefix, _, name = text.partition(":")
    scene: Scene = plugins.load(NAMES, prefix, "kind of scene name")(name)
    return scene


def _from_string(
    text: str, assets: Mapping[str, bytes] | None, trusted: bool, options: dict[str, Any]
) -> Scene:
    reader = reader_of_root(_root_tag(text)) or MjcfReader()  # MuJoCo says what is wrong with it
    source = "XML string" if reader.format == "MJCF" else f"{reader.format} string"
    key = _content(text, assets, options)
    if assets is not None:
        options = {**options, "assets": assets}

    def work() -> Scene:
        return Scene.from_read(reader.read_string(text, **options), source)

    if not trusted and (key is None or key not in _passed):
        size = len(text) + sum(map(len, (assets or {}).values()))
        guarded(work, source, Limits().for_input_of(size))
        _remember(key)
    with READING:
        return work()


_KEPT = 256
"""Strings that are remembered: more than there are tasks."""
_passed: dict[bytes, None] = {}
"""Hashes of the strings that came through the guard last: tasks load theirs again and again."""


def _content(
    text: str, assets: Mapping[str, bytes] | None, options: dict[str, Any]
) -> bytes | None:
    """A hash of all that a string is read from; None where files on disk may be part of it."""
    if options or (assets is None and ("file" in text or "plugin" in text)):
        return None
    found = hashlib.sha256(text.encode(errors="surrogatepass"))
    for name, data in sorted((assets or {}).items()):
        found.update(f"\0{len(name)} {name} {len(data)}\0".encode(errors="surrogatepass"))
        found.update(data)
    return found.digest()


def _remember(key: bytes | None) -> None:
    if key is not None:
        _passed[key] = None
    while len(_passed) > _KEPT:
        _passed.pop(next(iter(_passed)), None)


def _from_path(text: str, trusted: bool, options: dict[str, Any]) -> Scene:
    path = Path(text)
    if path.is_dir():
        raise SceneError(text, "is a folder", remedy="name a scene file inside it")
    if not path.exists():
        raise SceneError(text, "no such file", remedy=_similar_files(path))
    suffix, known = path.suffix.lower(), (*suffixes(), *ARCHIVE_SUFFIXES)
    if suffix not in known:
        refuse_other_kinds(text, suffix)
        raise SceneError(
            text,
            f"a scene has one of the suffixes {', '.join(known)}; got {suffix or 'none'!r}",
            remedy="rename the file if it is one of these formats",
        )
    size = _size(path)
    if suffix in ARCHIVE_SUFFIXES:
        with extracted(path, suffixes()) as scene_path:
            scene = _from_path(str(scene_path), trusted, options)
            return scene.replace_source(text)
    reader = _reader(path, suffix)
    if reader.root is not None and size > MOST_DOCUMENT:
        raise SceneError(
            text,
            f"has {size} bytes; at most {MOST_DOCUMENT} of a document are read",
            remedy="move meshes into files of their own",
        )

    def work() -> Scene:
        return Scene.from_read(reader.read(text, **options), text)

    if not (trusted or reader.isolated):
        candidate = Candidate.of(path, reader, options)
        if not candidate.passed_before():
            candidate.passed(guarded(work, text, Limits().for_input_of(size)))
    with READING:
        return work()


def _size(path: Path) -> int:
    """Bytes of a scene file."""
    try:
        size = size_of(path)
    except InputError as error:
        raise SceneError(str(path), str(error).removeprefix(f"{path}: ")) from None
    if size == 0:
        raise SceneError(str(path), "the file is empty")
    return size


def _reader(path: Path, suffix: str) -> Reader:
    """The reader for a file, by suffix; of XML the root element must agree.

    Raises:
      SceneError: it does not.
    """
    reader = reader_of_suffix(suffix)
    if reader.root is None:
        return reader
    tag = _root_tag(_head(path))
    other = reader if tag == reader.root else reader_of_root(tag)
    if other is reader or (other is None and isinstance(reader, MjcfReader)):
        return reader  # what is wrong with other XML, MuJoCo says
    raise SceneError(
        str(path),
        f"{reader.format} starts with <{reader.root}>; got <{tag}>"
        if tag
        else "holds no XML element",
        remedy=f"rename it to end in {other.suffix}" if other else None,
    )


def _head(path: Path) -> str:
    """The first characters of a file."""
    with path.open("rb") as file:
        data = file.read(65536)
    marked = data[:2] in (b"\xff\xfe", b"\xfe\xff")
    return data.decode("utf-16" if marked else "utf-8", errors="replace")


def _root_tag(text: str) -> str:
    """Name of the first element, skipping comments, declarations and the byte order mark."""
    position = 0
    while (start := text.find("<", position)) >= 0:
        if text.startswith("<!--", start):
            end = text.find("-->", start)
            if end < 0:
                return ""
            position = end + 3
        elif text[start + 1 : start + 2] in ("?", "!"):
            position = start + 1
        else:
            name = text[start + 1 : start + 200].replace("/", " ").replace(">", " ").split()
            return name[0] if name else ""
    return ""


def _similar_files(path: Path) -> str:
    if not path.parent.is_dir():
        return f"the folder {str(path.parent)!r} does not exist either"
    names = [entry.name for entry in path.parent.iterdir()]
    close = difflib.get_close_matches(path.name, names, n=1)
    return f"did you mean {str(path.parent / close[0])!r}?" if close else "check the path"
