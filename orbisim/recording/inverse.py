"""Joint positions from recorded body poses: inverse kinematics, where it has one solution."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.recording import quaternions as quat
from orbisim.recording.inference import Poses
from orbisim.recording.joints import Joint, Kind, joints

Floats = npt.NDArray[np.float64]

_ITERATIONS = 40
"""Steps of Levenberg and Marquardt, at most."""
_STARTS = 12
"""Random postures from which other solutions are looked for."""
_RANK = 1e-6
"""Smaller singular values, as a share of the largest, leave a direction undetermined."""
_ROWS = 5
"""Moments of a recording at which it is looked whether joints are determined."""


@dataclasses.dataclass(frozen=True)
class Solution:
    """What inverse kinematics found.

    Attributes:
      solved: joints that were filled in.
      undetermined: joints that the poses do not fix.
      ambiguous: joints for which a different solution fits the first sample as well.
      rms: root mean square misfit of the poses (m, and rad times 0.1 m).
    """

    solved: tuple[Joint, ...]
    undetermined: tuple[Joint, ...]
    ambiguous: tuple[Joint, ...]
    rms: float


class _Kinematics:
    """Misfit of the recorded poses as a function of some joints."""

    _ARM = 0.1
    """Metres that one radian of orientation error counts as."""

    def __init__(
        self, model: mujoco.MjModel, unknown: Sequence[Joint], xpos: Poses, xquat: Poses
    ) -> None:
        self.model, self.unknown = model, unknown
        moved = _moved(model, unknown)
        self.xpos = {body: values for body, values in xpos.items() if body in moved}
        self.xquat = {body: values for body, values in xquat.items() if body in moved}
        self.dofs = np.concatenate([np.arange(j.v.start, j.v.stop) for j in unknown])
        self.data = mujoco.MjData(model)
        self._jac = np.empty((3, model.nv)), np.empty((3, model.nv))

    def complete(self) -> npt.NDArray[np.bool_]:
        """[T]: rows in which every recorded pose is there."""
        parts = [np.isfinite(v).all(axis=1) for v in (*self.xpos.values(), *self.xquat.values())]
        return np.asarray(np.stack(parts).all(axis=0)) if parts else np.zeros(0, bool)

    def misfit(self, qpos: Floats, row: int) -> tuple[Floats, Floats]:
        """Residual [R] and its Jacobian [R, n]."""
        model, data = self.model, self.data
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        residual: list[Floats] = []
        slopes: list[Floats] = []
        for body in {*self.xpos, *self.xquat}:
            mujoco.mj_jacBody(model, data, *self._jac, body)
            if body in self.xpos:
                residual.append(self.xpos[body][row] - data.xpos[body])
                slopes.append(self._jac[0][:, self.dofs].copy())
            if body in self.xquat:
                turn = quat.multiply(self.xquat[body][row], quat.conjugate(data.xquat[body]))
                residual.append(self._ARM * quat.log(turn))
                slopes.append(self._ARM * self._jac[1][:, self.dofs])
        return np.concatenate(residual), np.concatenate(slopes)

    def solve(self, qpos: Floats, row: int) -> tuple[Floats, float]:
        """Damped Gauss-Newton from `qpos`; the solution and its misfit."""
        damping = 1e-6
        residual, slope = self.misfit(qpos, row)
        cost = float(residual @ residual)
        for _ in range(_ITERATIONS):
            normal = slope.T @ slope + damping * np.eye(len(self.dofs))
            move = np.zeros(self.model.nv)
            move[self.dofs] = np.linalg.solve(normal, slope.T @ residual)
            trial = qpos.copy()
            mujoco.mj_integratePos(self.model, trial, move, 1.0)
            after, slope_after = self.misfit(trial, row)
            if (reached := float(after @ after)) <= cost:
                done = cost - reached <= 1e-12 * cost + 1e-24
                qpos, residual, slope, cost = trial, after, slope_after, reached
                damping = max(damping * 0.1, 1e-12)
                if done:
                    break
            else:
                damping = damping * 10.0
                if damping > 1e3:
                    break
        return qpos, float(np.sqrt(cost / len(residual)))

    def undetermined(self, qpos: Floats, row: int) -> tuple[Joint, ...]:
        """Joints that can move without any recorded pose noticing."""
        _, slope = self.misfit(qpos, row)
        _, size, basis = np.linalg.svd(slope)
        rank = int((size > _RANK * max(size.max(initial=0.0), _RANK)).sum())
        free = np.zeros(self.model.nv)
        free[self.dofs] = np.abs(basis[rank:]).max(axis=0, initial=0.0)
        return tuple(j for j in self.unknown if (free[j.v] > 1e-3).any())


def _moved(model: mujoco.MjModel, some: Sequence[Joint]) -> set[int]:
    """Bodies that these joints move."""
    movers, found = {joint.body for joint in some}, set()
    for body in range(1, model.nbody):  # parents come before children
        if body in movers or int(model.body_parentid[body]) in found:
            found.add(body)
    return found


def solve(
    model: mujoco.MjModel, qpos: Floats, unknown: Sequence[Joint], xpos: Poses, xquat: Poses
) -> Solution:
    """Fills the unknown joints' columns of `qpos` [T, nq] row by row.

    Each row starts from the one before it; the first from the model's reference configuration, and
    then from random ones, to see whether another solution exists.
    """
    kinematics = _Kinematics(model, unknown, xpos, xquat)
    if not (kinematics.xpos or kinematics.xquat):
        return Solution((), tuple(unknown), (), 0.0)
    columns = np.concatenate([np.arange(j.q.start, j.q.stop) for j in unknown])
    others = np.setdiff1d(np.arange(model.nq), columns)
    rows = np.flatnonzero(kinematics.complete() & np.isfinite(qpos[:, others]).all(axis=1))
    if not rows.size:
        return Solution((), tuple(unknown), (), 0.0)
    current = np.array(model.qpos0)
    current[others] = qpos[rows[0], others]
    current, best = _first(kinematics, current, int(rows[0]))
    stuck, telling = _undetermined(kinematics, current, qpos, rows, others)
    if stuck:
        return Solution((), stuck, (), best)
    ambiguous = _ambiguous(kinematics, *telling)
    if ambiguous:
        return Solution((), (), ambiguous, best)
    misfits = np.empty(len(rows))
    for index, row in enumerate(rows):
        current[others] = qpos[row, others]
        current, misfits[index] = kinematics.solve(current, int(row))
        qpos[row, columns] = current[columns]
    return Solution(tuple(unknown), (), (), float(np.sqrt(np.mean(misfits**2))))


def _undetermined(
    kinematics: _Kinematics,
    first: Floats,
    qpos: Floats,
    rows: npt.NDArray[np.int64],
    others: npt.NDArray[np.int64],
) -> tuple[tuple[Joint, ...], tuple[Floats, float, int]]:
    """Joints that the poses do not fix, and a row that tells most: its solution, misfit, number.

    Looks at several rows, as the recording may start in a singular configuration (a straight arm).
    """
    current, fewest = first, tuple(kinematics.unknown)
    telling = (first, 0.0, int(rows[0]))
    for row in rows[np.linspace(0, len(rows) - 1, _ROWS).astype(int)]:
        current = current.copy()
        current[others] = qpos[row, others]
        current, misfit = kinematics.solve(current, int(row))
        stuck = kinematics.undetermined(current, int(row))
        if not stuck:
            return (), (current, misfit, int(row))
        if len(stuck) <= len(fewest):
            fewest, telling = stuck, (current, misfit, int(row))
    return fewest, telling


def _first(kinematics: _Kinematics, start: Floats, row: int) -> tuple[Floats, float]:
    """The best solution of the first row from several starts, the reference first."""
    best, misfit = kinematics.solve(start, row)
    for trial in _random_starts(kinematics, start):
        if misfit < 1e-6:
            break
        other, reached = kinematics.solve(trial, row)
        if reached < 0.9 * misfit:
            best, misfit = other, reached
    return best, misfit


def _random_starts(kinematics: _Kinematics, start: Floats) -> list[Floats]:
    model, rng = kinematics.model, np.random.default_rng(0)
    found = []
    for _ in range(_STARTS):
        trial = start.copy()
        move = np.zeros(model.nv)
        move[kinematics.dofs] = rng.uniform(-np.pi, np.pi, len(kinematics.dofs))
        mujoco.mj_integratePos(model, trial, move, 1.0)
        for joint in kinematics.unknown:
            if joint.scalar and model.jnt_limited[joint.id]:
                trial[joint.q] = rng.uniform(*model.jnt_range[joint.id])
        found.append(trial)
    return found


def _ambiguous(
    kinematics: _Kinematics, solution: Floats, misfit: float, row: int
) -> tuple[Joint, ...]:
    """Joints that another solution within the joint ranges puts elsewhere."""
    model = kinematics.model
    for trial in _random_starts(kinematics, solution):
        other, reached = kinematics.solve(trial, row)
        if reached > 1.5 * misfit + 1e-6 or not _within_ranges(kinematics, other):
            continue
        apart = np.empty(model.nv)
        mujoco.mj_differentiatePos(model, apart, 1.0, solution, other)
        for joint in joints(model):
            if joint.kind == Kind.HINGE:  # whole turns are the same pose
                apart[joint.v] = (apart[joint.v] + np.pi) % (2 * np.pi) - np.pi
        different = [j for j in kinematics.unknown if np.abs(apart[j.v]).max() > 1e-2]
        if different:
            return tuple(different)
    return ()


def _within_ranges(kinematics: _Kinematics, qpos: Floats) -> bool:
    model = kinematics.model
    for joint in kinematics.unknown:
        if joint.scalar and model.jnt_limited[joint.id]:
            low, high = model.jnt_range[joint.id]
            value = qpos[joint.q.start]
            turn = 2 * np.pi if joint.kind == Kind.HINGE else 0.0
            shifted = [value + k * turn for k in (-1, 0, 1)]
            if not any(low - 1e-3 <= v <= high + 1e-3 for v in shifted):
                return False
    return True
