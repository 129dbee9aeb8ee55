"""Motions of an end effector, made of segments, as actions at the control rate."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from orbisim.tasks.arm import ArmController, pointing_down

Floats = npt.NDArray[np.float64]
OPEN, CLOSED = -1.0, 1.0


@dataclasses.dataclass(frozen=True)
class Move:
    """Go to a position.

    Attributes:
      pos: m. yaw: of the tool about the vertical, rad; None keeps it.
      speed: m/s. accel: m/s^2. grip: from -1 (open) to 1 (closed); None keeps it.
      near: how close counts as there, m.
    """

    pos: tuple[float, float, float]
    yaw: float | None = None
    speed: float = 0.4
    accel: float = 3.0
    grip: float | None = None
    near: float = 0.003


@dataclasses.dataclass(frozen=True)
class Hold:
    """Stay for some control steps.

    Attributes:
      steps: how many. grip: None keeps it.
    """

    steps: int
    grip: float | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Follow:
    """Go along poses, one for each control step.

    Attributes:
      pos: [N, 3], m. rot: [N, 3, 3] of the tool. grip: None keeps it.
    """

    pos: Floats
    rot: Floats
    grip: float | None = None


Segment = Move | Hold | Follow
Plan = Iterator[Segment]
_TURN = 2.0
"""Speed of turning the tool, rad/s."""


class Director:
    """Carries out a plan, one action for each control step.

    A plan is a generator; it is asked for its next segment when the one before is done, and may
    look at the simulation then. After the last one the arm stays.

    Args:
      plan: the segments.
      arm: whose commanded pose the actions move.
      yaw: of the tool at the start, rad.
      step: duration of a control step, s.
      grip: at the start.
    """

    def __init__(
        self, plan: Plan, arm: ArmController, yaw: float, step: float, grip: float = CLOSED
    ) -> None:
        self._plan, self._arm, self._step = plan, arm, step
        self._pos = arm.pos.copy()
        self._velocity = np.zeros(3)
        self._yaw, self._grip = yaw, grip
        self._rot = pointing_down(yaw)
        self._segment: Segment | None = None
        self._left = 0

    def action(self) -> Floats:
        """The next action [7]."""
        if self._done():
            self._next()
        if isinstance(self._segment, Move):
            self._advance(self._segment)
        elif isinstance(self._segment, Follow):
            self._follow(self._segment)
        else:
            self._velocity = np.zeros(3)
            self._left -= 1
        return self._arm.action_to(self._pos, self._rot, self._grip)

    def _done(self) -> bool:
        if isinstance(self._segment, Move):
            there = np.linalg.norm(np.array(self._segment.pos) - self._pos) < self._segment.near
            yaw = self._segment.yaw
            return bool(there) and (yaw is None or abs(yaw - self._yaw) < 0.01)
        return self._left <= 0

    def _next(self) -> None:
        self._segment = next(self._plan, Hold(1))
        self._left = _length(self._segment)
        if self._segment.grip is not None:
            self._grip = self._segment.grip

    def _advance(self, move: Move) -> None:
        """Towards the goal at the move's speed, with bounded acceleration, braking before it."""
        way = np.array(move.pos) - self._pos
        distance = float(np.linalg.norm(way))
        speed = min(move.speed, np.sqrt(2 * move.accel * distance), distance / self._step)
        wanted = way / max(distance, 1e-9) * speed
        change = wanted - self._velocity
        most = move.accel * self._step
        size = float(np.linalg.norm(change))
        ends = distance <= move.speed * self._step and distance <= 2 * most * self._step
        self._velocity = wanted if ends or size <= most else self._velocity + change / size * most
        self._pos = self._pos + self._velocity * self._step
        if move.yaw is not None:
            most = _TURN * self._step
            self._yaw += float(np.clip(move.yaw - self._yaw, -most, most))
            self._rot = pointing_down(self._yaw)

    def _follow(self, path: Follow) -> None:
        """The next pose of a path."""
        index = len(path.pos) - self._left
        self._velocity = (path.pos[index] - self._pos) / self._step
        self._pos, self._rot = path.pos[index], path.rot[index]
        self._left -= 1


def _length(segment: Segment) -> int:
    """Control steps of a segment; 0 where they are not known before."""
    if isinstance(segment, Follow):
        return len(segment.pos)
    return segment.steps if isinstance(segment, Hold) else 0


def wander(
    rng: np.random.Generator, low: Floats, high: Floats, speed: tuple[float, float] = (0.1, 0.5)
) -> Plan:
    """Smooth random motion between points of a box, without end."""
    while True:
        x, y, z = rng.uniform(low, high)
        yield Move(
            (float(x), float(y), float(z)),
            yaw=float(rng.uniform(-1.2, 1.2)),
            speed=float(rng.uniform(*speed)),
            accel=1.5,
            grip=float(rng.choice([OPEN, CLOSED])) if rng.random() < 0.2 else None,
            near=0.05,
        )


def nearest_turn(yaw: float, period: float, around: float = 0.0) -> float:
    """The angle equal to `yaw` up to multiples of `period` that is nearest to `around`."""
    return float(yaw - period * np.round((yaw - around) / period))
