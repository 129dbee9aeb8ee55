"""Attribute values as plain Python and numpy values."""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import Sdf  # type: ignore[import-untyped,unused-ignore]

from orbisim.scene.usd.flat import Number, Value

MAX_ELEMENTS = 4096
"""Longest array that is handed over; geometry goes another way."""

_SINGLE = ("float", "point3f", "vector3f", "normal3f", "color3f", "color4f", "texCoord", "quatf")
_QUATERNIONS = ("quatf", "quatd", "quath")


def to_value(value: Any, type_name: str) -> Value | None:
    """A value as it can be handed over, or None if there is no counterpart."""
    if isinstance(value, bool):
        return value
    if isinstance(value, int):
        return value
    if isinstance(value, str):
        return value
    if isinstance(value, Sdf.AssetPath):
        return str(value.path)
    if hasattr(value, "__len__") and len(value) > MAX_ELEMENTS:
        return None
    if type_name in ("token[]", "string[]"):
        return tuple(str(item) for item in value)
    if type_name in ("int[]", "uint[]", "int64[]", "uint64[]", "bool[]"):
        return np.array(value, np.int64)
    return to_number(value, type_name)


def to_number(value: Any, type_name: str) -> Number | None:
    """A floating-point value as an array, or None if it is something else."""
    if type_name.rstrip("[]") in _QUATERNIONS:
        if type_name.endswith("[]"):
            return None
        value = [value.GetReal(), *value.GetImaginary()]
    try:
        if type_name.startswith(_SINGLE):
            return np.array(value, np.float32)
        return np.array(value, np.float64)
    except (TypeError, ValueError):
        return None
