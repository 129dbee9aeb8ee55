"""What looks wrong in a recording although it fits the scene."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from orbisim.errors import RecordingError
from orbisim.recording import quaternions as quat
from orbisim.recording.actuators import actuators
from orbisim.recording.bound import Bound, Suspicion
from orbisim.recording.clocks import slow
from orbisim.recording.joints import Joint, Kind, body_label, joints

Floats = npt.NDArray[np.float64]

_DEGREES = 180.0 / np.pi
_MARGIN = 0.05
"""Of a joint's range by which sensors may leave it."""
_MOST = 0.5
"""Relative misfit of a convention that may be right."""
_CHUNKS = 200
"""Stretches of a recording over which velocities are compared with positions."""


def suspicions(bound: Bound) -> list[Suspicion]:
    """What looks wrong.

    Raises:
      RecordingError: a quaternion is x, y, z, w, as its recorded angular velocity shows.
    """
    found: list[Suspicion] = []
    if (text := slow(bound.time)) is not None:
        found.append(Suspicion(f"'time': {text}"))
    for joint in joints(bound.model):
        if joint.scalar:
            found += _range(bound, joint)
            found += _rate(bound, joint)
        elif joint.quat is not None and joint.id in bound.measured - bound.unseen_turns:
            found += _turning(bound, joint)
    found += _poses(bound)
    found += _controls(bound)
    return found


def _range(bound: Bound, joint: Joint) -> Iterator[Suspicion]:
    """Positions outside the joint's range; degrees among them."""
    if not bound.model.jnt_limited[joint.id] or joint.id not in bound.measured:
        return
    low, high = bound.model.jnt_range[joint.id]
    values = bound.qpos[:, joint.q.start]
    values = values[np.isfinite(values)]
    margin = _MARGIN * (high - low)
    outside = (values < low - margin) | (values > high + margin)
    if not outside.any():
        return
    turned = values / _DEGREES
    degrees = (
        joint.kind == Kind.HINGE
        and outside.mean() > 0.2
        and np.abs(values).max() > 3.0 * max(abs(low), abs(high))
        and ((turned >= low - margin) & (turned <= high + margin)).all()
    )
    hint = "; in degrees it would be within: are these degrees?" if degrees else ""
    yield Suspicion(
        f"'qpos/{joint.label}' goes from {values.min():.4g} to {values.max():.4g} {joint.unit}; "
        f"the joint's range is {low:.4g} to {high:.4g}{hint}",
        wrong=bool(degrees),
    )


def _rate(bound: Bound, joint: Joint) -> Iterator[Suspicion]:
    """Recorded velocities that are not the derivative of the recorded positions."""
    ratio = _slope_ratio(bound.time, bound.qpos[:, joint.q.start], bound.qvel[:, joint.v.start])
    if ratio is None or 0.8 <= ratio <= 1.25:
        return
    name = f"'qvel/{joint.label}'"
    if ratio == 0:
        yield Suspicion(f"{name} stays zero although 'qpos/{joint.label}' moves", wrong=True)
        return
    causes = {
        -1.0: "is its sign reversed?",
        _DEGREES: "are they in degrees per second?",
        1 / _DEGREES: "are the positions in degrees?",
        60 / (2 * np.pi): "are they in revolutions per minute?",
    }
    close = [text for value, text in causes.items() if abs(ratio / value - 1) < 0.1]
    yield Suspicion(
        f"{name} is {ratio:.3g} times the derivative of 'qpos/{joint.label}'"
        + (f"; {close[0]}" if close else ""),
        wrong=bool(close),
    )


def _slope_ratio(time: Floats, position: Floats, velocity: Floats) -> float | None:
    """Velocity over the slope of position, by regression over stretches; None if unclear."""
    both = np.isfinite(position) & np.isfinite(velocity)
    if both.sum() < 10:
        return None
    t, q, v = time[both], position[both], velocity[both]
    travelled = np.concatenate([[0.0], np.cumsum(np.diff(t) * (v[1:] + v[:-1]) / 2)])
    rows = np.unique(np.linspace(0, len(t) - 1, min(len(t), _CHUNKS)).astype(int))
    dq, dv = np.diff(q[rows]), np.diff(travelled[rows])
    if not (dq**2).sum() > 0:
        return None
    if not (dv**2).sum() > 0:
        return 0.0
    correlation = (dq * dv).sum() / np.sqrt((dq**2).sum() * (dv**2).sum())
    if abs(correlation) < 0.8:
        return None
    return float((dq * dv).sum() / (dq**2).sum())


def _turning(bound: Bound, joint: Joint) -> Iterator[Suspicion]:
    """Orientation against the recorded angular velocity: order of components, frame."""
    assert joint.quat is not None
    assert joint.angular is not None
    q, w = bound.qpos[:, joint.quat], bound.qvel[:, joint.angular]
    both = np.isfinite(np.concatenate([q, w], axis=1)).all(axis=1)
    pairs = np.flatnonzero(np.logical_and(both[1:], both[:-1]))
    if len(pairs) < 5:
        return
    step = np.diff(bound.time)[pairs, None]
    mean = (w[pairs] + w[pairs + 1]) / 2
    fit = {
        (order, frame): _misfit(q[pairs][:, columns], q[pairs + 1][:, columns], step, mean, frame)
        for order, columns in (("wxyz", [0, 1, 2, 3]), ("xyzw", [3, 0, 1, 2]))
        for frame in ("body", "world")
    }
    name = f"qpos/{joint.label}"
    if joint.kind == Kind.FREE and f"xquat/{body_label(bound.model, joint.body)}" in (
        bound.recording.signals
    ):
        name = f"xquat/{body_label(bound.model, joint.body)}"
    wrong = min(fit["xyzw", "body"], fit["xyzw", "world"])
    right = min(fit["wxyz", "body"], fit["wxyz", "world"])
    if wrong < _MOST and wrong < 0.3 * right:
        raise RecordingError(
            bound.recording.source,
            "does not turn as its recorded angular velocity says; read as x, y, z, w it does",
            element=repr(name),
            remedy="record quaternions as w, x, y, z",
        )
    if fit["wxyz", "world"] < _MOST and fit["wxyz", "world"] < 0.3 * fit["wxyz", "body"]:
        yield Suspicion(
            f"the angular part of 'qvel/{joint.label}' fits {name!r} as a vector of the world "
            "frame; the scene needs it in the body's frame",
            wrong=True,
        )


def _misfit(before: Floats, after: Floats, step: Floats, rate: Floats, frame: str) -> float:
    """Angular velocity from consecutive quaternions against the recorded one, relative."""
    inverse = quat.conjugate(before)
    turn = quat.multiply(inverse, after) if frame == "body" else quat.multiply(after, inverse)
    found = quat.log(turn) / step
    size = float(np.sqrt(np.median((rate**2).sum(axis=1))))
    return float(np.sqrt(np.median(((found - rate) ** 2).sum(axis=1)))) / max(size, 1e-12)


def _poses(bound: Bound) -> Iterator[Suspicion]:
    """Quaternions that look like x, y, z, w: nearly 0, 0, 0, 1 where the scene has 1, 0, 0, 0."""
    rows = {bound.model.body(body).name: values for body, values in bound.xquat.items()}
    for name, values in rows.items():
        seen = values[np.isfinite(values).all(axis=1)]
        near = np.abs(seen[:, 3]) > 0.99
        if len(seen) and near.mean() > 0.5 and not (np.abs(seen[:, 0]) > 0.99).any():
            yield Suspicion(
                f"'xquat/{name}' is nearly (0, 0, 0, 1), half a turn about z; if the body is "
                "upright, the components are x, y, z, w and must be w, x, y, z"
            )


def _controls(bound: Bound) -> Iterator[Suspicion]:
    """Controls that the scene will clamp."""
    model = bound.model
    for actuator in actuators(model):
        for column in range(actuator.ctrl.start, actuator.ctrl.stop):
            if not model.actuator_ctrllimited[column] or actuator.id in bound.switched_off:
                continue
            low, high = model.actuator_ctrlrange[column]
            values = bound.ctrl[:, column]
            margin = 1e-6 * (high - low)
            beyond = ((values < low - margin) | (values > high + margin)).mean()
            if beyond > 0:
                yield Suspicion(
                    f"'ctrl/{actuator.label}' goes from {values.min():.4g} to {values.max():.4g}, "
                    f"beyond the actuator's range {low:.4g} to {high:.4g} in {beyond:.1%} of the "
                    "samples; the simulation clamps it"
                )
