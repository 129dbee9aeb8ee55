"""Single-precision numbers as the decimals that were meant.

UsdPhysics stores almost everything as float32. A file that says 9.81 holds 9.8100004196...;
any number that rounds to the same float32 is as good a reading of it, and the shortest decimal
among them is the one that the text form of the file shows. Taking it keeps a model that was
written by hand, or converted from a format with double precision, free of rounding noise.
"""

from __future__ import annotations

import math

import numpy as np

from orbisim.scene.usd.flat import FloatArray, Number

_MAX_DIGITS = 9  # enough to tell any two float32 apart


def exact(value: Number) -> FloatArray:
    """The value in double precision; float32 as the shortest decimals that round to it."""
    if value.dtype != np.float32:
        return np.asarray(value, np.float64)
    flat = [_shortest(np.float32(x)) for x in value.ravel()]
    return np.array(flat, np.float64).reshape(value.shape)


def converted(value: Number, factor: float) -> FloatArray:
    """`value * factor`, recovering decimals in whichever unit has the shorter ones.

    A limit of 1 rad is stored as 57.29578 degrees and reads as 1 rad; a limit of 45 degrees is
    stored as 45 and reads as pi/4. Either way the result, converted back and rounded to
    float32, is the stored number.
    """
    if factor == 1.0:
        return exact(value)
    if value.dtype != np.float32:
        return np.asarray(value, np.float64) * factor
    flat = [_converted(np.float32(x), factor) for x in value.ravel()]
    return np.array(flat, np.float64).reshape(value.shape)


def _shortest(x: np.float32) -> float:
    return float(str(x)) if math.isfinite(x) else float(x)


def _converted(x: np.float32, factor: float) -> float:
    if not math.isfinite(x) or x == 0.0:
        return float(x)
    direct = _shortest(x)
    target = float(x) * factor
    for digits in range(1, min(_significant(direct), _MAX_DIGITS + 1)):
        candidate = float(f"{target:.{digits - 1}e}")
        with np.errstate(over="ignore"):
            if np.float32(candidate / factor) == x:
                return candidate
    return direct * factor


def _significant(x: float) -> int:
    """How many significant decimal digits the shortest form of a number has."""
    mantissa = repr(abs(x)).partition("e")[0].replace(".", "").strip("0")
    return max(len(mantissa), 1)


_HALF_ULP = 2.0**-24
"""Half of the last place of a float32 near one: what rounding makes of a zero."""
_EXACT = 1e-12
"""Difference of float64 quaternions that are the same but for rounding."""
_ANGLE_ROUNDING = 2.5e-7  # rad: what rounding the components of a quaternion does to its angle


def unit_quaternion(value: Number) -> FloatArray:
    """A quaternion (w, x, y, z) of unit length; the identity for a zero one.

    A float32 rotation about a coordinate axis is read as the one with the shortest angle in
    degrees or radians that is within rounding of it: 0.70710677 is how the file has to write a
    quarter turn.
    """
    quat = exact(value)
    norm = float(np.linalg.norm(quat))
    if norm == 0.0:
        return np.array([1.0, 0.0, 0.0, 0.0])
    quat = quat / norm
    if value.dtype != np.float32:
        return quat
    axis = 1 + int(np.abs(quat[1:]).argmax())
    if np.abs(np.delete(quat, [0, axis])).max() > _HALF_ULP:
        return quat
    half = _simplest_angle(2 * math.atan2(quat[axis], quat[0])) / 2
    simple = np.zeros(4)
    simple[0], simple[axis] = math.cos(half), math.sin(half)
    return quat if np.abs(simple - quat).max() < _EXACT else simple


def _simplest_angle(angle: float) -> float:
    """The angle with the fewest digits, in degrees or radians, within rounding of an angle."""
    for digits in range(1, 5):
        for unit in (math.pi / 180, 1.0):
            candidate = float(f"{angle / unit:.{digits - 1}e}") * unit
            if abs(candidate - angle) <= _ANGLE_ROUNDING:
                return candidate
    return angle
