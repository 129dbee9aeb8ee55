"""Quaternions (w, x, y, z) as arrays [..., 4].

`scipy.spatial.transform.Rotation` has all this for unit quaternions, but refuses rows of NaN, which
mark missing samples here, and derivatives of quaternions, which are not of unit norm.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def multiply(a: Floats, b: Floats) -> Floats:
    """The Hamilton product a b."""
    wa, va, wb, vb = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    scalar = wa * wb - (va * vb).sum(-1, keepdims=True)
    return np.concatenate([scalar, wa * vb + wb * va + np.cross(va, vb)], axis=-1)


def conjugate(a: Floats) -> Floats:
    """The conjugate; the inverse of a unit quaternion."""
    return np.asarray(a * np.array([1.0, -1.0, -1.0, -1.0]))


def normalized(a: Floats) -> Floats:
    """Scaled to unit norm."""
    return np.asarray(a / np.linalg.norm(a, axis=-1, keepdims=True))


def exp(vector: Floats) -> Floats:
    """The quaternion of a rotation vector [..., 3]."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), vector * 0.5 * np.sinc(angle / (2 * np.pi))], -1)


def log(a: Floats) -> Floats:
    """The rotation vector [..., 3] of a unit quaternion, of length at most pi."""
    a = np.where(a[..., :1] < 0, -a, a)
    sine = np.linalg.norm(a[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, a[..., :1])
    safe = np.where(sine > 0, sine, 1.0)
    return np.asarray(a[..., 1:] * np.where(sine > 1e-12, angle / safe, 2.0))


def rotate(a: Floats, vector: Floats) -> Floats:
    """The vectors [..., 3] turned by the quaternions."""
    w, v = a[..., :1], a[..., 1:]
    t = 2.0 * np.cross(v, vector)
    return np.asarray(vector + w * t + np.cross(v, t))


def continuous(a: Floats) -> Floats:
    """Signs chosen so that consecutive quaternions [T, 4] agree; rows of NaN are passed over."""
    result = np.array(a, np.float64)
    seen = np.flatnonzero(np.isfinite(result).all(axis=1))
    dots = (result[seen[1:]] * result[seen[:-1]]).sum(axis=1)
    flips = np.cumprod(np.concatenate([[1.0], np.where(dots < 0, -1.0, 1.0)]))
    result[seen] *= flips[: len(seen), None]
    return result


def body_rate_at_end(log_vector: Floats, rate: Floats) -> Floats:
    """Derivative of the rotation vector r(t) of exp(r) when the body-frame rate is `rate`.

    The inverse of the right Jacobian of SO(3) (Chirikjian, Stochastic Models, Information Theory,
    and Lie Groups, volume 2, 2012, section 10.6) applied to the rate; r [..., 3] shorter than 2 pi.
    """
    angle2 = (log_vector**2).sum(-1, keepdims=True)
    angle = np.sqrt(angle2)
    half = angle / 2
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle2)
    cot = half / np.tan(np.where(small, 1.0, half))
    factor = np.where(small, 1.0 / 12.0, (1.0 - np.where(small, 1.0, cot)) / safe)
    turned = np.cross(log_vector, rate)
    return np.asarray(rate + 0.5 * turned + factor * np.cross(log_vector, turned))
