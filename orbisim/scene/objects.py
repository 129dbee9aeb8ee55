"""Scenes from what is in memory already: other scenes, MuJoCo's models, dm_control's elements."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, TypeAlias

import mujoco

from orbisim.errors import InputError, SceneError
from orbisim.scene.mjcf import read_mjcf_string
from orbisim.scene.scene import Scene

SceneSource: TypeAlias = Any
"""A path; a name such as `suite:cheetah-run`; a document as text or bytes; a `Scene`, `MjSpec` or
`MjModel`; an element of `dm_control.mjcf`, or an entity of its composer."""

_ACCEPTED = (
    "a path, a name such as suite:cheetah-run, a document as text, a Scene, an MjSpec, an MjModel "
    "or a dm_control mjcf element"
)


def scene_of(source: object) -> Scene | None:
    """The scene that an object stands for; None if it is a path or text.

    Raises:
      SceneError: MuJoCo cannot compile it.
    """
    if isinstance(source, Scene):
        return source
    if isinstance(source, mujoco.MjSpec):
        return Scene.from_spec(source)
    model = getattr(source, "ptr", source)  # dm_control wraps MjModel
    if isinstance(model, mujoco.MjModel):
        return Scene.from_model(model)
    element = getattr(source, "mjcf_model", source)  # of a composer entity
    if hasattr(element, "to_xml_string") and hasattr(element, "root"):
        return _from_mjcf(element)
    return None


def _from_mjcf(element: Any) -> Scene:
    """The whole model that an element of `dm_control.mjcf` belongs to, with its assets."""
    root = element.root
    while root.parent_model is not None:  # attached: what holds it has the actuators' targets
        root = root.parent_model
    read = read_mjcf_string(root.to_xml_string(), root.get_assets(), "mjcf element")
    return Scene.from_read(read, f"mjcf model {root.model!r}")


def text_of(source: object) -> str:
    """A document given as bytes, as text.

    Raises:
      InputError: it is neither text nor bytes nor a path.
      SceneError: the bytes are not UTF-8 or UTF-16 text.
    """
    if isinstance(source, (bytes, bytearray, memoryview)):
        return _decoded(bytes(source))
    try:
        path = os.fspath(source)  # type: ignore[call-overload]
    except TypeError:
        raise InputError(f"a scene is {_ACCEPTED}; got {type(source).__name__}") from None
    return _decoded(path) if isinstance(path, bytes) else str(path)


def _decoded(data: bytes) -> str:
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        raise SceneError(
            "XML bytes",
            f"byte 0x{data[error.start]:02x} at {error.start} is not text",
            remedy="give a document as UTF-8; load a compiled model (.mjb) with "
            "mujoco.MjModel.from_binary_path and give the model",
        ) from None


def assets_of(assets: Mapping[str, Any] | None) -> dict[str, bytes] | None:
    """The contents of files as bytes; text is taken as UTF-8, as dm_control does.

    Raises:
      InputError: they are not names with contents.
    """
    if assets is None:
        return None
    if not isinstance(assets, Mapping):
        raise InputError(f"assets are file names with contents; got {type(assets).__name__}")
    found = {}
    for name, data in assets.items():
        if not isinstance(name, str) or not isinstance(data, (str, bytes, bytearray)):
            raise InputError(
                f"assets are file names with contents as bytes; got {name!r}: {type(data).__name__}"
            )
        found[name] = data.encode() if isinstance(data, str) else bytes(data)
    return found
