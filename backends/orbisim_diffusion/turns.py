"""Which of the turns of a joint that look the same a robot is in."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial.transform import Rotation
from scipy.special import log_ndtr

from orbisim_diffusion.resting import Scalar
from orbisim_diffusion.synthesis import Eye

Floats = npt.NDArray[np.float64]

_SAME_PIXELS = 0.02
"""Drawings whose pixels differ by less are of what looks the same: 5 of 255, below the noise."""
_FIT = 0.03
"""Standard deviation of a fitted hand's turn beside what its curvature says, rad: frames of `push`
are 1.0 degrees off in the median and 2.6 in 90 %."""
_READ = 16.0
"""Odds that a network reads the right one of two like turns where they are nearly as far from the
keyframe (1.40 rad or more): right in 271 of 288 frames of 40 episodes of `push`, and in 186 of 192
of 20 others. Elsewhere it was wrong in 2 of 6,180, so that odds hardly matter there."""


class Turns:
    """Chooses turns of joints that an image does not tell apart.

    Half a turn of a gripper draws the same image. Whatever is read off an image is then equally
    likely under both turns, and priors decide. One is the scene's first keyframe: what the joint
    moves is held as there, within a quarter turn in the world, since a task turns a gripper to a
    heading by the shorter way. That is not the joint's own angle: as an arm reaches to a side its
    base turns, and the last joint turns back to hold the hand as it was. The other is what a
    network has learned of how arms are held: it reads one of the two.

    Args:
      eye: draws the scene. rest: [nq] of the keyframe (or `qpos0`). scalar: joints of one
        coordinate. geoms: that are drawn; without objects.
    """

    def __init__(self, eye: Eye, rest: Floats, scalar: Scalar, geoms: torch.Tensor) -> None:
        self.eye, self.rest, self.scalar, self.geoms = eye, rest, scalar, geoms
        model = eye.model
        joints = np.asarray(model.dof_jntid)[scalar.dof]
        self._bodies = np.asarray(model.jnt_bodyid)[joints].astype(int)
        self._parents = np.asarray(model.body_parentid).astype(int)

    def held(self, joints: Floats, std: Floats | None = None) -> Floats:
        """The joints, turned by half turns that no image tells to where the prior has them.

        Of whole turns, which leave everything where it is, each hinge takes the one nearest to the
        keyframe. Joints stay in their ranges.

        Args:
          joints: [joints]. std: [joints] standard deviations, rad and m, of joints that were
            fitted from where a network reads them. Its turn then has the odds `_READ`, times those
            of the hand being within a quarter turn of the keyframe's under this uncertainty. None
            where no network was asked: the turn nearer to the keyframe's.
        """
        found = np.array(joints, dtype=np.float64)
        for i in np.flatnonzero(self.scalar.hinge).tolist():
            other = self._turned(found, i, 1)
            if other is None:
                continue
            nearer = 0.5 * (self._away(other, i) - self._away(found, i))
            if std is None:
                odds = nearer
            else:
                off = nearer / float(np.hypot(std[i], _FIT))
                odds = np.log(_READ) + float(log_ndtr(off) - log_ndtr(-off))
            if odds < 0.0 and self._alike(found, other, i):
                found = other
            else:
                whole = self._turned(found, i, 0)
                found = found if whole is None else whole
        return found

    def nearest(self, joints: Floats, to: Floats) -> Floats:
        """The joints [joints], turned as no image tells to where others [joints] are nearest.

        What a network reads of one frame has no memory of the turns of the frames before. Joints
        are clipped to their ranges first; whole turns and, where they look the same, half turns
        stay in them.
        """
        found: Floats = np.clip(joints, self.scalar.low, self.scalar.high)
        for i in np.flatnonzero(self.scalar.hinge).tolist():
            halves = int(np.round((to[i] - found[i]) / np.pi))
            whole = 2 * int(np.round((to[i] - found[i]) / (2.0 * np.pi)))
            for turns in dict.fromkeys((halves, whole)):
                other = found.copy()
                other[i] += turns * np.pi
                held = self.scalar.low[i] <= other[i] <= self.scalar.high[i]
                if held and (turns % 2 == 0 or self._alike(found, other, i)):
                    found = other
                    break
        return found

    def _turned(self, joints: Floats, i: int, halves: int) -> Floats | None:
        """After an even (0) or odd (1) number of half turns: nearest to rest within the range."""
        best = None
        rest, low, high = self.rest[self.scalar.qpos[i]], self.scalar.low[i], self.scalar.high[i]
        nearest = 2.0 * np.round((rest - joints[i] - halves * np.pi) / (2.0 * np.pi)) + halves
        for turns in (nearest, nearest - 2.0, nearest + 2.0):
            reached = joints[i] + turns * np.pi
            if not low <= reached <= high:
                continue
            if best is None or abs(reached - rest) < abs(best[i] - rest):
                best = joints.copy()
                best[i] = reached
        return best

    def _away(self, joints: Floats, i: int) -> float:
        """Angle, rad, by which what a joint moves is turned in the world from where it rests."""
        data, mats = mujoco.MjData(self.eye.model), []
        for state in (self.rest, self._state(joints)):
            data.qpos[:] = state
            mujoco.mj_kinematics(self.eye.model, data)
            mats.append(data.xmat[self._bodies[i]].reshape(3, 3).copy())
        return float(Rotation.from_matrix(mats[1] @ mats[0].T).magnitude())

    def _alike(self, one: Floats, other: Floats, i: int) -> bool:
        """Whether both draw the same, with what hangs on the joint as it rests.

        Fingers that were read a little differently are not a side that tells a turn.
        """
        states = np.stack([self._state(one), self._state(other)])
        carried = {int(self._bodies[i])}
        for body in range(min(carried) + 1, len(self._parents)):  # parents come first
            if self._parents[body] in carried:
                carried.add(body)
        for j, column in enumerate(self.scalar.qpos):
            own = self._bodies[j] == self._bodies[i]  # of a body's joints, later ones hang on it
            if self._bodies[j] in carried and (j > i if own else True):
                states[:, column] = self.rest[column]
        pixels = torch.arange(self.eye.size**2)
        first, second = self.eye.draw(states, pixels, self.geoms).pixels
        return float((first - second).abs().max()) < _SAME_PIXELS

    def _state(self, joints: Floats) -> Floats:
        """[nq] with some joints, the rest of it at rest."""
        state = np.array(self.rest)
        state[self.scalar.qpos] = joints
        return state
