"""Transforms of bodies and joints as 4x4 matrices, from MuJoCo's numbers."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def motion(hinge: bool, reference: float) -> list[Floats]:
    """Coefficients of 1, sin q, cos q and q in the motion about (along) z by q - reference."""
    still, sine, cosine, linear = np.zeros((4, 4, 4))
    if not hinge:
        still = np.eye(4)
        still[2, 3], linear[2, 3] = -reference, 1.0
        return [still, sine, cosine, linear]
    still[2, 2] = still[3, 3] = 1.0
    turn, cross = np.diag([1.0, 1, 0, 0]), np.zeros((4, 4))
    cross[1, 0], cross[0, 1] = 1.0, -1.0
    c, s = np.cos(reference), np.sin(reference)
    return [still, s * turn + c * cross, c * turn - s * cross, linear]


def axis_frame(axis: Floats, anchor: Floats) -> Floats:
    """A frame at an anchor [3] whose z is an axis [3]."""
    quat = np.zeros(4)
    mujoco.mju_quatZ2Vec(quat, np.ascontiguousarray(axis))
    return transform(anchor, quat)


def transform(pos: Floats, quat: Floats) -> Floats:
    """The matrix [4, 4] of a position [3] and a quaternion [4]."""
    matrix, flat = np.eye(4), np.zeros(9)
    mujoco.mju_quat2Mat(flat, np.ascontiguousarray(quat))
    matrix[:3, :3], matrix[:3, 3] = flat.reshape(3, 3), pos
    return matrix


def nested(array: Any) -> tuple:  # type: ignore[type-arg]
    """An array as nested tuples of floats."""
    return tuple(nested(a) if a.ndim else float(a) for a in array)
