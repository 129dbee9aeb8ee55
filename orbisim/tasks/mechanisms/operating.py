"""Operates a mechanism by a hand: its operations as paths of the tool."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation, Slerp

from orbisim.tasks.mechanisms.model import Grip, Mechanism, Operation
from orbisim.tasks.motion import CLOSED, OPEN, Follow, Hold, Plan
from orbisim.tasks.staging import Stage

Floats = npt.NDArray[np.float64]
_FINE = 64
"""Points of a path before it is timed."""
_HALF_TURN = np.array([-1.0, -1.0, 1.0])
"""Signs of the tool's axes after half a turn about the direction in which it points."""


@dataclasses.dataclass(frozen=True)
class Manner:
    """How the hand moves.

    Attributes:
      speed: m/s. turning: rad/s. step: duration of a control step, s.
      offset: [3] where it takes hold, beside where it should, m, in the tool's frame.
    """

    speed: float
    turning: float
    step: float
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Operator:
    """Carries out operations in a simulation.

    Args:
      stage: the simulation. prefix: of the names of the mechanism's bodies and joints there.
      manner: how the hand moves.
      pos, rot: [3], [3, 3] where the tool begins.
    """

    def __init__(self, stage: Stage, prefix: str, manner: Manner, pos: Floats, rot: Floats) -> None:
        self._stage, self._prefix, self._manner = stage, prefix, manner
        self._pos, self._rot = np.array(pos, np.float64), np.array(rot, np.float64)
        self._scratch = mujoco.MjData(stage.model)
        self._flip = np.ones(3)

    def plan(self, mechanism: Mechanism) -> Plan:
        """All operations, one after another."""
        for operation in mechanism.operations:
            yield from self._operate(operation)

    def _operate(self, operation: Operation) -> Plan:
        joints = list(dict.fromkeys(joint for joint, _ in operation.motions))
        at = {joint: self._position(joint) for joint in joints}
        self._flip = self._better_half(operation, at)
        pos, rot = self._hold(operation.grip, at)
        before = pos - operation.grip.clearance * rot[:, 2]
        grip = OPEN if operation.closed else CLOSED
        yield self._to([before], [rot], grip)
        yield self._to([pos], [rot], grip, 0.4)
        if operation.closed:
            yield Hold(6, grip=CLOSED)
        for joint, target in operation.motions:
            values = np.linspace(at[joint], target, _FINE)
            poses = [self._hold(operation.grip, {**at, joint: float(v)}) for v in values]
            yield self._to([p for p, _ in poses], [r for _, r in poses], None, 0.5)
            at[joint] = target
        yield Hold(3)
        if operation.release:
            yield Hold(4, grip=OPEN if operation.closed else CLOSED)
            away = self._pos - operation.grip.clearance * self._rot[:, 2]
            yield self._to([away], [self._rot], None, 0.7)

    def _better_half(self, operation: Operation, at: Mapping[str, float]) -> Floats:
        """Which of the two ways to take hold, half a turn apart, leaves the tool nearer to how it
        is now, at the beginning and after each motion."""
        self._flip, reached = np.ones(3), dict(at)
        held = [self._hold(operation.grip, reached)[1]]
        for joint, target in operation.motions:
            reached[joint] = target
            held.append(self._hold(operation.grip, reached)[1])
        straight = sum(float(np.trace(self._rot.T @ rot)) for rot in held)
        turned = sum(float(np.trace(self._rot.T @ (rot * _HALF_TURN))) for rot in held)
        return _HALF_TURN if turned > straight else np.ones(3)

    def _position(self, joint: str) -> float:
        return float(self._stage.data.joint(self._prefix + joint).qpos[0])

    def _hold(self, grip: Grip, at: Mapping[str, float]) -> tuple[Floats, Floats]:
        """Where the tool is when it holds a grip, with joints at some positions."""
        data = self._scratch
        data.qpos[:] = self._stage.data.qpos
        for joint, value in at.items():
            data.joint(self._prefix + joint).qpos[0] = value
        mujoco.mj_kinematics(self._stage.model, data)
        body = data.body(self._prefix + grip.part)
        frame = body.xmat.reshape(3, 3)
        rot = frame @ grip.rotation * self._flip
        return body.xpos + frame @ np.array(grip.pos) + rot @ np.array(self._manner.offset), rot

    def _to(
        self, pos: Sequence[Floats], rot: Sequence[Floats], grip: float | None, pace: float = 1.0
    ) -> Follow:
        """A path through poses, from where the tool is, that starts and ends at rest."""
        if len(pos) == 1:
            points = np.linspace(self._pos, pos[0], _FINE)
            ends = Slerp([0.0, 1.0], Rotation.from_matrix([self._rot, rot[0]]))
            rotations = ends(np.linspace(0, 1, _FINE)).as_matrix()
        else:
            points, rotations = np.array([self._pos, *pos]), np.array([self._rot, *rot])
        length = np.linalg.norm(np.diff(points, axis=0), axis=1)
        relative = Rotation.from_matrix(rotations[1:] @ np.swapaxes(rotations[:-1], 1, 2))
        manner = self._manner
        spent = length / manner.speed + relative.magnitude() / manner.turning
        clock = np.concatenate([[0.0], np.cumsum(spent + 1e-6)])
        steps = max(2, int(np.ceil(1.5 * clock[-1] / (pace * manner.step))))
        x = np.arange(1, steps + 1) / steps
        when = clock[-1] * x**2 * (3 - 2 * x)
        path = np.stack([np.interp(when, clock, points[:, i]) for i in range(3)], axis=1)
        turned = Slerp(clock, Rotation.from_matrix(rotations))(when).as_matrix()
        self._pos, self._rot = path[-1], turned[-1]
        return Follow(path, turned, grip)
