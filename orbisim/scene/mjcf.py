"""MJCF: whatever plain MuJoCo compiles, through `mujoco.MjSpec`, losslessly."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco

from orbisim.errors import InputError, SceneError
from orbisim.scene.files import contents, embed
from orbisim.scene.mjcf_files import check_meshes, documents
from orbisim.scene.reading import Reader, ReadResult
from orbisim.scene.safety.confine import confinement
from orbisim.scene.safety.xmlsafe import without_comments

COMPILER_ERRORS = (ValueError, RuntimeError, mujoco.FatalError)
"""What MuJoCo's parser and compiler raise."""

_ENTITY = re.compile(rb"<!ENTITY", re.IGNORECASE)


def read_mjcf(path: str) -> ReadResult:
    """Reads an MJCF file.

    Raises:
      SceneError: the file is missing, is not MJCF, or MuJoCo refuses it.
    """
    found = documents(Path(path))
    for document in found:
        data = contents(document)
        refuse_entities(data, str(document))
        refuse_other_encodings(data, str(document))
    folders = list(dict.fromkeys(document.parent for document in found))
    try:
        spec = _spec(path)
    except COMPILER_ERRORS as error:
        raise as_scene_error(error, path) from None
    notes = check_meshes(spec, folders, path)
    if confinement() is not None:  # the files are there only while the scene is read
        embed(spec, folders, path)
    return ReadResult(spec, warnings=notes)


def _spec(path: str) -> mujoco.MjSpec:
    """MuJoCo tells documents by the suffix `.xml`; others are read under a name that has it."""
    if path.endswith(".xml"):
        return mujoco.MjSpec.from_file(path)
    alias = f"{path}.xml"
    with mujoco.MjVfs() as files:
        files[alias] = Path(path).read_bytes()
        return mujoco.MjSpec.from_file(alias, vfs=files)


def read_mjcf_string(
    xml: str, assets: Mapping[str, bytes] | None = None, source: str = "XML string"
) -> ReadResult:
    """Reads MJCF from a string, with the files it refers to given as `assets`."""
    try:
        refuse_entities(xml.encode(), source)
    except UnicodeEncodeError as error:
        problem = f"character {error.start} is half of a surrogate pair, not text"
        raise SceneError(source, problem, remedy="decode the document properly") from None
    assets = dict(assets or {})
    included = {name: data for name, data in assets.items() if name.lower().endswith(".xml")}
    try:
        spec = mujoco.MjSpec.from_string(xml, include=included, assets=assets)
    except COMPILER_ERRORS as error:
        raise as_scene_error(error, source) from None
    return ReadResult(spec)


class MjcfReader(Reader):
    """MJCF files and strings."""

    format = "MJCF"
    suffix = ".xml"
    root = "mujoco"

    def read(self, path: str, **options: Any) -> ReadResult:
        """See `read_mjcf`."""
        _no_options(options)
        return read_mjcf(path)

    def read_string(self, text: str, **options: Any) -> ReadResult:
        """See `read_mjcf_string`; `assets` is the one option."""
        assets = options.pop("assets", None)
        _no_options(options)
        return read_mjcf_string(text, assets)


def _no_options(options: Mapping[str, Any]) -> None:
    if options:
        raise InputError(f"the MJCF reader takes no options; got {', '.join(sorted(options))}")


def refuse_entities(xml: bytes, source: str) -> None:
    """Raises `SceneError` if the document declares entities (MuJoCo would not expand them)."""
    if _ENTITY.search(xml) and _ENTITY.search(without_comments(xml)):
        raise SceneError(
            source,
            "the document declares entities (<!ENTITY ...>), which are not expanded",
            remedy="write their content out and remove the declarations",
        )


def refuse_other_encodings(xml: bytes, source: str) -> None:
    """Raises `SceneError` if names or values are not UTF-8; comments may be anything."""
    try:
        xml.decode()
    except UnicodeDecodeError:
        try:
            without_comments(xml).decode()
        except UnicodeDecodeError as error:
            line = error.object.count(b"\n", 0, error.start) + 1
            raise SceneError(
                source,
                f"line {line}: byte 0x{error.object[error.start]:02x} is not UTF-8 text",
                remedy="save it as UTF-8",
            ) from None


_ELEMENT_LINE = re.compile(
    r"Element '(?P<tag>[^']*)',(?: id \d+,)? line (?P<line>\d+)"
    r"|Element name '(?P<name>[^']*)', id (?P<id>-?\d+)(?:, line (?P<line2>\d+))?"
)


def as_scene_error(error: Exception, source: str) -> SceneError:
    """Turns MuJoCo's message, which spans lines, into one that names file and element."""
    text = " ".join(str(error).split())
    text = re.sub(r"^(XML )?(Error: )+", "", text)
    element = None
    if found := _ELEMENT_LINE.search(text):
        text = (text[: found.start()] + text[found.end() :]).strip(" ,;")
        line = found["line"] or found["line2"]
        what = f"<{found['tag']}>" if found["tag"] else f"element {found['name']!r}"
        if found["name"] == "":
            what = f"element number {found['id']}"
        element = f"line {line}, {what}" if line and line != "0" else what
    return SceneError(source, f"MuJoCo refuses it: {text}", element=element)
