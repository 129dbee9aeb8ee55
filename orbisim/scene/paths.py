"""What a user may mean by a path, and what to do where it is no scene."""

from __future__ import annotations

import re
import urllib.parse
from pathlib import Path

from orbisim.errors import InputError, SceneError

_URL = re.compile(r"^[A-Za-z][A-Za-z0-9+.-]+://")

_OTHER_KINDS = {
    ".mjb": (
        "is a compiled MuJoCo model, which holds no document",
        "load it with mujoco.MjModel.from_binary_path and give the model to load_scene",
    ),
    ".xacro": (
        "is a macro document, not URDF",
        "expand it first: xacro robot.xacro > robot.urdf (pip install xacro)",
    ),
    ".sdf": ("is SDFormat, for which no reader is installed", "convert it to URDF or MJCF"),
    ".stl": ("is a mesh, not a scene", "refer to it from MJCF: <mesh file=.../>"),
    ".obj": ("is a mesh, not a scene", "refer to it from MJCF: <mesh file=.../>"),
}


def path_of(text: str) -> str:
    """The path that a text stands for; `~` is the user's home, `file://` is taken off.

    Raises:
      InputError: it is empty, or an address on the network.
    """
    if not text.strip():
        raise InputError("the scene's name is empty; give a path, a task name or a document")
    if text.startswith("file://"):
        text = urllib.parse.unquote(re.sub(r"^file://(localhost)?(?=/)", "", text))
    if _URL.match(text):
        raise InputError(
            f"{text[:200]!r} is an address on the network; download the scene with the files that "
            "it refers to, and give its path"
        )
    if "\0" in text:
        raise InputError(f"a path holds no NUL character; got {text[:200]!r}")
    if not text.startswith("~"):
        return text
    try:
        return str(Path(text).expanduser())
    except RuntimeError:
        raise InputError(f"{text!r}: there is no such user; give the path in full") from None


def refuse_other_kinds(text: str, suffix: str) -> None:
    """Raises `SceneError` for files that people take for scenes, with what to do instead."""
    if suffix in _OTHER_KINDS:
        problem, remedy = _OTHER_KINDS[suffix]
        raise SceneError(text, problem, remedy=remedy)
