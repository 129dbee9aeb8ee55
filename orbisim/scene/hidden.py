"""Joints that an effect has added to a scene: no encoder reads them.

Their names stand in `<custom><text name="orbisim:hidden">` as a JSON list, so that a recording of
the declared joints fits the augmented scene too.
"""

from __future__ import annotations

import json
from typing import Any

import mujoco

from orbisim.scene.texts import read_text, replace_text

TEXT_NAME = "orbisim:hidden"


def hide_joint(spec: mujoco.MjSpec, name: str) -> None:
    """Adds a joint to the list in the document."""
    names = [known for text in spec.texts if text.name == TEXT_NAME for known in _parsed(text.data)]
    replace_text(spec, TEXT_NAME, [*names, name])


def hidden_joints(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the joints that effects have added; none if the list is not readable."""
    try:
        names = _strings(read_text(model, TEXT_NAME))
    except ValueError:
        return ()
    known = {model.joint(i).name for i in range(model.njnt)}
    return tuple(name for name in names if name in known)


def _parsed(text: str) -> list[str]:
    try:
        return _strings(json.loads(text))
    except ValueError:
        return []


def _strings(names: Any) -> list[str]:
    """The names in a list; what else a document may hold there is passed over."""
    return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []
