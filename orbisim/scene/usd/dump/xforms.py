"""Transforms of prims, evaluated in double precision.

OpenUSD multiplies matrices made of float32 components. Evaluating the ops here keeps decimals
(a scale of 0.1) and unit quaternions exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom  # type: ignore[import-untyped,unused-ignore]

from orbisim.scene.usd.decimals import exact, unit_quaternion
from orbisim.scene.usd.dump.values import to_number
from orbisim.scene.usd.flat import FloatArray

TIME = Usd.TimeCode.EarliestTime()
"""When attributes are read: the default value, or the first sample of what is animated."""


def local_matrix(prim: Any) -> tuple[FloatArray, bool]:
    """[4, 4] prim to parent for column vectors, and whether the prim resets the stack."""
    matrix = np.eye(4)
    xformable = UsdGeom.Xformable(prim)
    if not xformable:
        return matrix, False
    for op in xformable.GetOrderedXformOps():
        matrix = matrix @ _op_matrix(op)
    return matrix, bool(xformable.GetResetXformStack())


def _op_matrix(op: Any) -> FloatArray:
    value = op.GetAttr().Get(TIME)
    if value is None:
        return np.eye(4)
    evaluate = _EVALUATE.get(op.GetOpType())
    if evaluate is None:
        return np.array(op.GetOpTransform(TIME), np.float64).T
    number = to_number(value, str(op.GetTypeName()))
    if number is None:
        return np.array(op.GetOpTransform(TIME), np.float64).T
    read = unit_quaternion if op.GetOpType() == _Op.TypeOrient else exact
    matrix = evaluate(read(number))
    return np.asarray(np.linalg.inv(matrix)) if op.IsInverseOp() else matrix


def _linear(block: FloatArray) -> FloatArray:
    matrix = np.eye(4)
    matrix[:3, :3] = block
    return matrix


def _translate(offset: FloatArray) -> FloatArray:
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return matrix


def _scale(factors: FloatArray) -> FloatArray:
    return _linear(np.diag(np.broadcast_to(factors, 3)))


def _orient(quat: FloatArray) -> FloatArray:
    """Rotation by a unit quaternion (w, x, y, z)."""
    w, x, y, z = quat
    return _linear(
        np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
    )


def _rotate(axis: int, degrees: float) -> FloatArray:
    half = math.radians(math.remainder(degrees, 720.0)) / 2
    quat = np.zeros(4)
    quat[0], quat[1 + axis] = math.cos(half), math.sin(half)
    return _orient(quat)


def _about(axis: int) -> Callable[[FloatArray], FloatArray]:
    return lambda degrees: _rotate(axis, float(degrees))


def _euler(order: str) -> Callable[[FloatArray], FloatArray]:
    """Rotation about fixed axes, the first letter's first."""
    axes = ["XYZ".index(letter) for letter in order]

    def evaluate(degrees: FloatArray) -> FloatArray:
        first, second, third = (_rotate(axis, float(degrees[axis])) for axis in axes)
        return third @ second @ first

    return evaluate


def _along(axis: int) -> Callable[[FloatArray], FloatArray]:
    return lambda distance: _translate(np.eye(3)[axis] * distance)


def _stretch(axis: int) -> Callable[[FloatArray], FloatArray]:
    return lambda factor: _scale(np.where(np.arange(3) == axis, factor, 1.0))


_Op = UsdGeom.XformOp
_EVALUATE: dict[Any, Callable[[FloatArray], FloatArray]] = {
    _Op.TypeTranslate: _translate,
    _Op.TypeScale: _scale,
    _Op.TypeOrient: _orient,
    _Op.TypeTransform: lambda matrix: matrix.T.copy(),
    **{
        getattr(_Op, f"TypeRotate{order}"): _euler(order)
        for order in ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")
    },
    **{getattr(_Op, f"TypeRotate{letter}"): _about(i) for i, letter in enumerate("XYZ")},
    **{
        getattr(_Op, f"TypeTranslate{letter}"): _along(i)
        for i, letter in enumerate("XYZ")
        if hasattr(_Op, f"TypeTranslate{letter}")
    },
    **{
        getattr(_Op, f"TypeScale{letter}"): _stretch(i)
        for i, letter in enumerate("XYZ")
        if hasattr(_Op, f"TypeScale{letter}")
    },
}
