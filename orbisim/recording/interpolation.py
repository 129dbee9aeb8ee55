"""States between the steps of a simulation."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.recording import quaternions as quat
from orbisim.recording.joints import joints
from orbisim.recording.zero_order_hold import SNAP

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


class Between:
    """Places between the nodes of a uniform grid.

    Args:
      position: [N], in steps from node 0; one within `SNAP` of a node is taken to be on it.

    Attributes:
      base: [N] the node before (the one after is base + 1). part: [N] in [0, 1].
    """

    def __init__(self, position: Floats) -> None:
        nearest = np.round(position)
        position = np.where(np.abs(position - nearest) < SNAP, nearest, position)
        self.base: Ints = np.maximum(np.ceil(position).astype(np.int64) - 1, 0)
        self.part: Floats = position - self.base

    def __getitem__(self, chosen: npt.NDArray[np.bool_]) -> Between:
        found = Between.__new__(Between)
        found.base, found.part = self.base[chosen], self.part[chosen]
        return found


def linear(before: Floats, after: Floats, part: Floats) -> Floats:
    """Linear interpolation between rows [N, n]; exact at part 0 and 1."""
    s = part[:, None]
    return np.where(s == 0, before, np.where(s == 1, after, before + s * (after - before)))


def positions(
    model: mujoco.MjModel,
    before: tuple[Floats, Floats],
    after: tuple[Floats, Floats],
    part: Floats,
    step: float,
) -> Floats:
    """Positions [N, nq] between two states by a cubic Hermite curve on the manifold.

    Third order in the step where position and velocity belong together; exact at part 0 and 1.
    Rotations follow the curve of their rotation vector relative to the state before.

    Args:
      model: the model.
      before, after: qpos [N, nq] and qvel [N, nv].
      part: [N], in [0, 1]. step: time from `before` to `after`, s.
    """
    (q0, v0), (q1, v1) = before, after
    result = np.array(q0)
    straight_q, straight_v = _straight(model)
    result[:, straight_q] = _hermite(
        q0[:, straight_q], v0[:, straight_v], q1[:, straight_q], v1[:, straight_v], part, step
    )
    for joint in joints(model):
        if joint.quat is not None and joint.angular is not None:
            q, w = joint.quat, joint.angular
            result[:, q] = _turn(q0[:, q], v0[:, w], q1[:, q], v1[:, w], part, step)
    result[part == 0] = q0[part == 0]
    result[part == 1] = q1[part == 1]
    return result


def _straight(model: mujoco.MjModel) -> tuple[Ints, Ints]:
    """Addresses of the coordinates that are no rotations."""
    q: list[int] = []
    v: list[int] = []
    for joint in joints(model):
        width = 1 if joint.scalar else 3 if joint.quat != joint.q else 0
        q += range(joint.q.start, joint.q.start + width)
        v += range(joint.v.start, joint.v.start + width)
    return np.array(q, np.int64), np.array(v, np.int64)


def _hermite(q0: Floats, v0: Floats, q1: Floats, v1: Floats, part: Floats, step: float) -> Floats:
    s = part[:, None]
    rise = s * s * (3.0 - 2.0 * s)
    curve = (s - 1.0) * s * (s - 1.0) * v0 + s * s * (s - 1.0) * v1
    return np.asarray(q0 + rise * (q1 - q0) + step * curve)


def _turn(q0: Floats, w0: Floats, q1: Floats, w1: Floats, part: Floats, step: float) -> Floats:
    end = quat.log(quat.multiply(quat.conjugate(q0), q1))
    rate = quat.body_rate_at_end(end, w1)
    vector = _hermite(np.zeros_like(end), w0, end, rate, part, step)
    return quat.normalized(quat.multiply(q0, quat.exp(vector)))
