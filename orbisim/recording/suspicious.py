"""Recordings that no effect should be read out of."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbisim.errors import RecordingError
from orbisim.recording import Recording, bind
from orbisim.recording.actuators import actuators
from orbisim.recording.bound import Bound
from orbisim.recording.joints import Joint, joints
from orbisim.recording.noise import lattice_step
from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]


def refuse(recording: Recording, scene: Scene) -> list[str]:
    """Notes about a recording.

    Raises:
      RecordingError: it does not fit the scene, or a signal is clearly not what its name says.
    """
    bound = bind(recording, scene)
    for one in bound.suspicions:
        if one.wrong:
            raise RecordingError(
                recording.source,
                one.text,
                remedy="correct the recording; effects fitted to it would be wrong",
            )
    _still(bound)
    _swapped(bound)
    return [f"{recording.source}: {note}" for note in (*bound.notes, *_clipped(bound))]


def within_range(recording: Recording) -> Recording:
    """Without readings of positions that stand at the end of a sensor's range: they are missing.

    A body at a hard stop, or at rest, is still read with the sensor's noise or its rounding. Where
    readings are not rounded, many that are equal to the largest, entered in full motion, are the
    sensor's end and not the body's.
    """
    changed, told = {}, []
    for name, values in recording.signals.items():
        if name.startswith("qpos/") and values.ndim == 1 and (beyond := _beyond(values)).any():
            changed[name] = np.where(beyond, np.nan, values)
            told.append(
                f"{name!r} stands at its extreme values without noise, entered in full motion: "
                f"clipped; {beyond.sum()} of {len(values)} readings count as missing"
            )
    if not changed:
        return recording
    return recording.replace(
        signals={**recording.signals, **changed}, notes=(*recording.notes, *told)
    )


def _beyond(values: Floats) -> npt.NDArray[np.bool_]:
    """[T]: whether a reading is an end of the sensor's range, not a position."""
    out, seen = np.zeros(len(values), bool), values[np.isfinite(values)]
    if not _flat_ends(seen):
        return out
    ends = (seen.max(), seen.min())
    inside = seen[(seen != ends[0]) & (seen != ends[1])]
    if lattice_step(inside) > 0.0:  # an encoder that rounds reads a body at a stop so, too
        return out
    steps = np.abs(np.diff(seen))
    usual = float(np.median(steps[steps > 0]))
    for end in ends:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], values == end, [False]])))
        for first, last in edges.reshape(-1, 2):
            around = [values[k] for k in (first - 1, last) if 0 <= k < len(values)]
            abrupt = max((abs(end - one) for one in around), default=0.0)
            if last - first >= _STANDS and abrupt > _ABRUPT * usual:
                out[first:last] = True
    return out


_STANDS = 3
"""Equal readings in a row: two may be a sample that was sent twice."""
_ABRUPT = 0.1
"""Of the usual step: a body that comes to rest by itself takes smaller ones before."""


def _still(bound: Bound) -> None:
    """Raises if a driven joint never moves: its encoder, or the recording, is dead."""
    every = joints(bound.model)
    driven = {
        a.joint for a in actuators(bound.model) if np.ptp(bound.ctrl[:, a.ctrl], axis=0).any()
    }
    for joint in every:
        values = bound.qpos[:, joint.q]
        values = values[np.isfinite(values).all(axis=1)]
        if joint.scalar and joint.id in driven and len(values) > 8 and not np.ptp(values):
            raise RecordingError(
                bound.recording.source,
                f"is {values[0, 0]:.6g} in all {len(values)} samples although the joint is driven",
                element=f"'qpos/{joint.label}'",
                remedy="check the encoder and the column; leave the recording out",
            )


def _swapped(bound: Bound) -> None:
    """Raises if the velocities of two joints fit each other's positions."""
    scalar = [j for j in joints(bound.model) if j.scalar and j.id in bound.measured]
    if len(scalar) < 2:
        return
    table = np.array([[_agreement(bound, a, b) for b in scalar] for a in scalar])
    for i, a in enumerate(scalar):
        for k, b in enumerate(scalar[:i]):
            own, crossed = max(table[i, i], table[k, k]), min(table[i, k], table[k, i])
            if crossed > 0.97 and own < 0.93:
                raise RecordingError(
                    bound.recording.source,
                    f"the velocity of {a.label!r} is the derivative of the position of "
                    f"{b.label!r}, and the other way round",
                    element=f"'qvel/{a.label}', 'qvel/{b.label}'",
                    remedy="swap the columns back",
                )


def _agreement(bound: Bound, position: Joint, velocity: Joint) -> float:
    """Correlation of a joint's position steps with another's recorded velocity; 0 if unknown."""
    q, v = bound.qpos[:, position.q.start], bound.qvel[:, velocity.v.start]
    both = np.isfinite(q) & np.isfinite(v)
    if both.sum() < 16:
        return 0.0
    time, q, v = bound.time[both], q[both], v[both]
    rows = np.unique(np.linspace(0, len(time) - 1, min(len(time), 400)).astype(int))
    travelled = np.concatenate([[0.0], np.cumsum(np.diff(time) * (v[1:] + v[:-1]) / 2)])
    dq, dv = np.diff(q[rows]), np.diff(travelled[rows])
    if not dq.any() or not dv.any():
        return 0.0
    return float(np.corrcoef(dq, dv)[0, 1])


def _clipped(bound: Bound) -> list[str]:
    """Signals that stop at their largest or smallest value: the sensor's range was left."""
    found: list[str] = []
    for joint in joints(bound.model):
        for kind, values in (("qpos", bound.qpos[:, joint.q]), ("qvel", bound.qvel[:, joint.v])):
            for column in values.T:
                if _flat_ends(column[np.isfinite(column)]):
                    found.append(
                        f"'{kind}/{joint.label}' stays at its extreme values for long stretches: "
                        "clipped, or at rest there?"
                    )
    return found


def _flat_ends(values: Floats) -> bool:
    if len(values) < 50 or len(np.unique(values)) < 20:
        return False
    share = [(values == end).mean() for end in (values.max(), values.min())]
    return bool(max(share) > 0.05)
