"""JSON that a scene carries for us, in `<custom><text name="...">`."""

from __future__ import annotations

import json
from typing import Any

import mujoco

from orbisim import plugins

PREFIX = "orbisim:"
"""Starts the names of the texts that are ours."""
ACTING = ("orbisim:effects", "orbisim:rest")
"""Texts that a classical backend applies at every timestep."""
CHECKS = "orbisim.texts"
"""Entry point group of functions (model, source) that raise `SceneError` unless a text is readable;
the plug-in `effects` checks `orbisim:effects`."""


def replace_text(spec: mujoco.MjSpec, name: str, data: Any) -> None:
    """Writes JSON under a name in place of what stands there; None only removes it."""
    for text in list(spec.texts):
        if text.name == name:
            spec.delete(text)
    if data is not None:
        spec.add_text(name=name, data=json.dumps(data))


def read_text(model: mujoco.MjModel, name: str) -> Any:
    """The JSON that a compiled model carries under a name; None if it carries none.

    Raises:
      ValueError: the text is not JSON in UTF-8, or `null`, which `replace_text` never writes.
    """
    index = _index(model, name)
    if index < 0:
        return None
    start, size = int(model.text_adr[index]), int(model.text_size[index])
    raw = bytes(model.text_data[start : start + size]).split(b"\0")[0]
    try:
        data = json.loads(raw.decode())
    except RecursionError:
        raise ValueError("JSON that is nested too deeply") from None
    if data is None:
        raise ValueError("expected a list or an object, got null")
    return data


def acts_between_timesteps(model: mujoco.MjModel) -> bool:
    """Whether the model carries something that plain MuJoCo would not apply."""
    return any(_index(model, name) >= 0 for name in ACTING)


def check_texts(model: mujoco.MjModel, source: str) -> None:
    """Checks everything of ours that a model carries.

    Raises:
      SceneError: something is not readable, or does not fit the model.
    """
    for name in plugins.names(CHECKS) if model.ntext else ():
        if _index(model, PREFIX + name) >= 0:
            plugins.load(CHECKS, name, "text in a scene")(model, source)


def _index(model: mujoco.MjModel, name: str) -> int:
    return int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, name))
