"""Joints that an effect has added to a scene: no encoder reads them.

Their names stand in `<custom><text name="orbisim:hidden">` as a JSON list, so that a recording of
the declared joints fits the augmented scene too.
"""

from __future__ import annotations

import json

import mujoco

TEXT_NAME = "orbisim:hidden"


def hide_joint(spec: mujoco.MjSpec, name: str) -> None:
    """Adds a joint to the list in the document."""
    names: list[str] = []
    for text in list(spec.texts):
        if text.name == TEXT_NAME:
            names = json.loads(text.data)
            spec.delete(text)
    spec.add_text(name=TEXT_NAME, data=json.dumps([*names, name]))


def hidden_joints(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the joints that effects have added; none if the list is not readable."""
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, TEXT_NAME)
    if index < 0:
        return ()
    start, size = int(model.text_adr[index]), int(model.text_size[index])
    raw = bytes(model.text_data[start : start + size]).split(b"\0")[0]
    try:
        names = json.loads(raw.decode())
    except ValueError:
        return ()
    known = {model.joint(i).name for i in range(model.njnt)}
    return tuple(str(n) for n in names if n in known) if isinstance(names, list) else ()
