"""Demonstrations cut into pieces, and carried over to other layouts.

As mimic-style generators do: a piece of a demonstration is kept relative to the object that it is
about; in another layout it is moved with that object, and pieces are joined by straight lines.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation, Slerp

from orbisim.tasks.arm import rotation_matrix
from orbisim.tasks.motion import Follow, nearest_turn

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Frame:
    """Where an object is: position [3], m, and turn about the vertical, rad."""

    pos: Floats
    yaw: float


@dataclasses.dataclass(frozen=True, eq=False)
class Piece:
    """A part of a demonstration, about one object; N control steps.

    Attributes:
      about: the object. frame: where it was when the piece began.
      pos: [N, 3] commanded positions of the tool, m. rot: [N, 3, 3]. grip: [N].
    """

    about: str
    frame: Frame
    pos: Floats
    rot: Floats
    grip: Floats

    def moved(self, frame: Frame, period: float) -> Piece:
        """The piece about the object where it is now.

        Args:
          period: turn after which the object looks the same, rad; the smallest turn is made.
        """
        turn = nearest_turn(frame.yaw - self.frame.yaw, period)
        rotation = rotation_matrix(np.array([0.0, 0.0, turn]))
        pos = (self.pos - self.frame.pos) @ rotation.T + frame.pos
        return dataclasses.replace(self, frame=frame, pos=pos, rot=rotation @ self.rot)

    def paths(self) -> Iterator[Follow]:
        """What the hand does: a path for each stretch with the same grip."""
        cuts = [0, *(np.flatnonzero(np.diff(self.grip)) + 1), len(self.grip)]
        for first, last in itertools.pairwise(cuts):
            yield Follow(self.pos[first:last], self.rot[first:last], float(self.grip[first]))


def commanded(action: Floats, pos: Floats, rot: Floats) -> tuple[Floats, Floats]:
    """Poses [N, 3], [N, 3, 3] of the tool that actions [N, 7] command from a first one."""
    positions, rotations = [], []
    for row in action:
        pos, rot = pos + row[:3], rotation_matrix(row[3:6]) @ rot
        positions.append(pos)
        rotations.append(rot)
    return np.array(positions), np.array(rotations)


def bridge(
    start: tuple[Floats, Floats], end: tuple[Floats, Floats], speed: float, step: float
) -> Follow:
    """A straight way from one pose of the tool to another, from rest to rest.

    Args:
      speed: m/s, on average. step: duration of a control step, s.
    """
    length = float(np.linalg.norm(end[0] - start[0]))
    turn = float(Rotation.from_matrix(end[1] @ start[1].T).magnitude())
    steps = max(2, int(np.ceil(max(length / speed, turn / 1.5) / step)))
    x = np.arange(1, steps + 1) / steps
    share = x**2 * (3 - 2 * x)
    pos = start[0] + share[:, None] * (end[0] - start[0])
    rot = Slerp([0.0, 1.0], Rotation.from_matrix([start[1], end[1]]))(share).as_matrix()
    return Follow(pos, rot)
