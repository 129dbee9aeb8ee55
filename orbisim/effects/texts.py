"""JSON that a scene carries for us, in `<custom><text name="...">`."""

from __future__ import annotations

import json
from typing import Any

import mujoco


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
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, name)
    if index < 0:
        return None
    start, size = int(model.text_adr[index]), int(model.text_size[index])
    raw = bytes(model.text_data[start : start + size]).split(b"\0")[0]
    data = json.loads(raw.decode())
    if data is None:
        raise ValueError("expected a list or an object, got null")
    return data
