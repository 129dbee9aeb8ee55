"""What a clone of `task:stack` sees, and in whose frame."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.tasks.motion import nearest_turn
from orbisim.tasks.stack import DEMONSTRATIONS, demonstration

Floats = npt.NDArray[np.float64]
CHANGES = 4
"""Of the grip in an episode that succeeds: two cubes are taken and let go."""
ABOUT = np.array([1, 0, 2, 1, 1])
"""The cube that the hand is about after so many changes of the grip: it takes cube 2, puts it on
cube 1, takes cube 3, puts it on cube 2, and leaves."""
PIECE = np.array([0, 1, 2, 3, 3])
"""The piece of a demonstration (see `stack.demonstration`) after so many changes."""
TURN = np.deg2rad(2.0) / 0.01
"""rad of noise for each metre of it: 2 degrees with 1 cm, as `tools/eval_dynamics.py` has it."""
OWN = 3 + 2 + 2 + 1 + (CHANGES + 1) + 2 + DEMONSTRATIONS
"""Numbers of `Seen.own`."""


@dataclasses.dataclass(frozen=True)
class Seen:
    """What is measured, over N states.

    Attributes:
      command: [N, 3] where the tool is told to be, m.
      told: [N] the turn about the vertical that it is told to have, rad; it points down.
      fingers: [N, 2], m. grip: [N] the command before, -1 open to 1 closed.
      changes, age: [N] how often the grip's command has changed, and for how many steps it has been
        as it is: the policy's only memory, without which it stays where demonstrations pass twice.
      source: [N] number of the demonstration that is followed. Ten of them lead to the same cube on
        ten ways; a clone that is not told which follows their mean, which is none.
      cubes: [N, 3, 3], m. yaw: [N, 3] of an axis of each that lies flat, rad.
    """

    command: Floats
    told: Floats
    fingers: Floats
    grip: Floats
    changes: Floats
    age: Floats
    source: npt.NDArray[np.int64]
    cubes: Floats
    yaw: Floats

    def blurred(self, noise: float, rng: np.random.Generator) -> Seen:
        """With errors of measurement; commands are known."""
        if not noise:
            return self
        n = rng.standard_normal
        return dataclasses.replace(
            self,
            cubes=self.cubes + noise * n(self.cubes.shape),
            yaw=self.yaw + TURN * noise * n(self.yaw.shape),
        )

    def turn(self, yaws: Floats) -> Floats:
        """[N] by which the demonstration's piece is turned about its cube, rad, up to an eighth.

        Args:
          yaws: [demonstrations, pieces] of the cubes in the demonstrations (`piece_yaws`).
        """
        done = self.done
        rows = np.arange(len(done))
        away = self.yaw[rows, ABOUT[done]] - yaws[self.source, PIECE[done]]
        return np.asarray(away - np.pi / 2 * np.round(away / (np.pi / 2)))

    def features(self, yaws: Floats) -> npt.NDArray[np.float32]:
        """[N, F], of order one, about the cube that the hand is about and turned with it. Cubes
        look the same after a quarter turn."""
        done, turn = self.done, self.turn(yaws)
        count = len(done)
        about = self.cubes[np.arange(count), ABOUT[done]]
        tool = turned(self.command - about, -turn)
        cubes = turned(self.cubes - self.command[:, None], -turn[:, None])
        rows: list[Any] = [
            self.own(),
            10 * tool,
            np.tanh(50 * tool),
            np.sin(self.told - turn)[:, None],
            np.cos(self.told - turn)[:, None],
            10 * cubes.reshape(count, 9),
            np.tanh(50 * cubes).reshape(count, 9),
            10 * self.cubes[:, :, 2],
            np.sin(4 * (self.yaw - self.told[:, None])),
            np.cos(4 * (self.yaw - self.told[:, None])),
        ]
        return np.concatenate(rows, axis=1).astype(np.float32)

    @property
    def done(self) -> npt.NDArray[np.int64]:
        """[N] changes of the grip, those beyond the last as the last."""
        return np.minimum(self.changes, CHANGES).astype(np.int64)

    def own(self) -> npt.NDArray[np.float32]:
        """[N, OWN] what the robot knows without seeing any cube."""
        rows: list[Any] = [
            10 * (self.command - [0.5, 0.0, 0.15]),
            np.sin(self.told)[:, None],
            np.cos(self.told)[:, None],
            50 * self.fingers,
            self.grip[:, None],
            np.eye(CHANGES + 1)[self.done],
            self.age[:, None] / 30,
            np.exp(-self.age / 5)[:, None],
            np.eye(DEMONSTRATIONS)[self.source],
        ]
        return np.concatenate(rows, axis=1).astype(np.float32)


def joined(seen: list[Seen]) -> Seen:
    """One after another."""
    names = [field.name for field in dataclasses.fields(Seen)]
    return Seen(**{name: np.concatenate([getattr(one, name) for one in seen]) for name in names})


def piece_yaws() -> Floats:
    """[demonstrations, pieces]: turns of the cubes that the pieces are about, rad."""
    rows = [[p.frame.yaw for p in demonstration(number)] for number in range(DEMONSTRATIONS)]
    return np.array(rows)


def turned(vectors: Floats, angle: Floats) -> Floats:
    """Vectors [..., 3] turned about the vertical by [...], rad."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


def flat_yaw(quat: Floats) -> Floats:
    """[...] of quaternions [..., 4]: turn of an axis that lies flat, rad."""
    w, x, y, z = np.moveaxis(quat, -1, 0)
    rows = np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        -2,
    )
    axis = np.abs(rows[..., 2, :]).argmin(-1)[..., None]
    along = [np.take_along_axis(rows[..., k, :], axis, -1)[..., 0] for k in (0, 1)]
    return np.asarray(np.arctan2(along[1], along[0]))


def yaw_of(rot: Floats, around: float = 0.0) -> float:
    """Turn of a tool [3, 3] that points down, rad, within half a turn of `around`."""
    return nearest_turn(float(np.arctan2(rot[1, 0], rot[0, 0])), 2 * np.pi, around)
