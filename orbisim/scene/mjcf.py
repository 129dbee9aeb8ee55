"""MJCF: whatever plain MuJoCo compiles, through `mujoco.MjSpec`, losslessly."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import mujoco

from orbisim.errors import SceneError
from orbisim.scene.reading import ReadResult

_ENTITY = re.compile(rb"<!ENTITY", re.IGNORECASE)
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)


def read_mjcf(path: str) -> ReadResult:
    """Reads an MJCF file.

    Raises:
      SceneError: the file is missing, is not MJCF, or MuJoCo refuses it.
    """
    refuse_entities(Path(path).read_bytes(), path)
    try:
        return ReadResult(mujoco.MjSpec.from_file(path))
    except (ValueError, mujoco.FatalError) as error:
        raise as_scene_error(error, path) from None


def read_mjcf_string(
    xml: str, assets: Mapping[str, bytes] | None = None, source: str = "XML string"
) -> ReadResult:
    """Reads MJCF from a string, with the files it refers to given as `assets`."""
    refuse_entities(xml.encode(), source)
    assets = dict(assets or {})
    included = {name: data for name, data in assets.items() if name.lower().endswith(".xml")}
    try:
        spec = mujoco.MjSpec.from_string(xml, include=included, assets=assets)
    except (ValueError, mujoco.FatalError) as error:
        raise as_scene_error(error, source) from None
    return ReadResult(spec)


def refuse_entities(xml: bytes, source: str) -> None:
    """Raises `SceneError` if the document declares entities (MuJoCo would not expand them)."""
    if _ENTITY.search(xml) and _ENTITY.search(_COMMENT.sub(b"", xml)):
        raise SceneError(
            source,
            "the document declares entities (<!ENTITY ...>), which are not expanded",
            remedy="write their content out and remove the declarations",
        )


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
