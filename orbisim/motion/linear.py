"""The deviation from a reference motion as a linear system driven by what the scene lacks.

With the reference xbar_k at the samples, the map F_k of the scene over a sampling interval, its
derivatives A_k by the state and B_k by a constant generalized force, and the defect
d_k = xbar_{k+1} - F_k(xbar_k):

    xi_{k+1} = A_k xi_k + B_k f_k + g_k - d_k,     y_k - C xbar_k = C xi_k + s_k + n_k,

where f is the missing generalized force, g and s are other missing terms in the state and in the
measurement, and n is the measurement noise. All are exact to first order in xi. The derivatives
are finite differences of the backend's own steps.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import mujoco
import mujoco.batch
import numpy as np
import numpy.typing as npt

from orbisim.effects.base import Effect, index_of
from orbisim.effects.carry import hooks_of
from orbisim.effects.stepping import Timesteps, step_batch
from orbisim.host.cpus import threads_for
from orbisim.host.deadline import NEVER, Deadline
from orbisim.motion.closeness import may_touch
from orbisim.motion.hidden import Layout, carried_along
from orbisim.motion.samples import Samples, parts_of, substeps
from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

_EPS = 1e-5
"""rad, m, and a second of them, by which one-sided differences move a state: between rounding of
double precision and the curve of the step."""


@dataclasses.dataclass(frozen=True, eq=False)
class Intervals:
    """All sampling intervals of all recordings, one after the other.

    Attributes:
      recording: [N] number of the recording. row: [N] row at which the interval starts.
      A: [N, 2 nv, 2 nv]. B: [N, 2 nv, nv]. defect: [N, 2 nv].
      usable: [N] whether both ends are known and nothing became non-finite.
    """

    recording: Ints
    row: Ints
    A: Floats
    B: Floats
    defect: Floats
    usable: npt.NDArray[np.bool_]


class IntervalMap:
    """A scene's map over sampling intervals, for many intervals at once.

    Args:
      declared: the scene whose coordinates the samples have.
      samples: the recordings.
      rows: for each recording the rows at which intervals start.
      variant: the scene that is simulated (the declared one with effects added); the declared one
        if None.
      clock: recorded over true durations.
      deadline: when simulation ends with `TimeIsUpError`.
    """

    def __init__(
        self,
        declared: Scene,
        samples: Sequence[Samples],
        rows: Sequence[Ints],
        variant: Scene | None = None,
        clock: float = 1.0,
        deadline: Deadline = NEVER,
    ) -> None:
        self.model, self.deadline = declared.model, deadline
        self.variant = declared if variant is None else variant
        self.recording = np.concatenate([np.full(len(r), i) for i, r in enumerate(rows)])
        self.row = np.concatenate([np.asarray(r) for r in rows]).astype(np.int64)
        pick = [(samples[i], np.asarray(r)) for i, r in enumerate(rows)]
        self.qpos = np.concatenate([s.qpos[r] for s, r in pick])
        self.qvel = np.concatenate([s.qvel[r] for s, r in pick])
        self.after_qpos = np.concatenate([s.qpos[r + 1] for s, r in pick])
        self.after_qvel = np.concatenate([s.qvel[r + 1] for s, r in pick])
        self._pick = pick
        self.ctrl = np.concatenate([s.ctrl[r] for s, r in pick])
        self.force = np.concatenate([s.force[r] for s, r in pick])
        self.start = np.concatenate([s.time[r] for s, r in pick])
        self.duration = np.concatenate([s.time[r + 1] - s.time[r] for s, r in pick]) / clock
        hidden = [carried_along(s, declared.model, self.variant.model) for s in samples]
        self.act = np.concatenate([hidden[i][0][r] for i, r in enumerate(rows)])
        self.history = np.concatenate([hidden[i][1][r] for i, r in enumerate(rows)])
        step = float(self.model.opt.timestep)
        self.substeps = substeps(self.duration, step)

    def __len__(self) -> int:
        return len(self.row)

    def advance(
        self,
        qpos: Floats | None = None,
        qvel: Floats | None = None,
        force: Floats | None = None,
        scene: Scene | None = None,
        only: Bools | None = None,
        finer: int = 1,
    ) -> tuple[Floats, Floats]:
        """States at the ends of the intervals, from other starts, forces or another scene.

        Args:
          qpos, qvel: starts; the reference if None. force: added generalized force.
          scene: another scene of the variant's layout.
          only: [N] intervals that are simulated, all if None; the others' ends are NaN.
          finer: into how many steps each timestep is divided.
        """
        model = self.variant.model if scene is None else scene.model
        place = Layout(self.model, model)
        qpos = self.qpos if qpos is None else qpos
        qvel = self.qvel if qvel is None else qvel
        out_q, out_v = np.full_like(self.qpos, np.nan), np.full_like(self.qvel, np.nan)
        wanted = np.ones(len(self), bool) if only is None else only
        hooks = hooks_of(model)
        for count in np.unique(self.substeps[wanted]):
            self.deadline.check()
            index = np.flatnonzero(wanted & (self.substeps == count))
            parts = parts_of([s for s, _ in self._pick], int(count))
            each = int(count) // parts * finer
            threads = threads_for(model, len(index), 1 if hooks else each)
            batch = mujoco.batch.Batch(model, len(index), threads)
            Timesteps(model, batch).set(self.duration[index] / (count * finer))
            batch.bind("time")[:] = self.start[index]
            batch.bind("qpos")[:] = model.qpos0
            batch.bind("qpos")[:, place.q] = qpos[index]
            batch.bind("qvel")[:, place.v] = qvel[index]
            batch.bind("act")[:] = self.act[index]
            batch.bind("history")[:] = self.history[index]
            ctrl, applied = self._inputs(parts)
            if force is not None:
                applied = applied + force[:, None]
            for part in range(parts):
                batch.bind("qfrc_applied")[:, place.v] = applied[index, part]
                step_batch(model, batch, hooks, ctrl[index, part], each)
            out_q[index] = batch.bind("qpos")[:, place.q]
            out_v[index] = batch.bind("qvel")[:, place.v]
        return out_q, out_v

    def _inputs(self, parts: int) -> tuple[Floats, Floats]:
        """[N, parts, nu] and [N, parts, nv]: controls and forces, over parts of each interval."""
        known = [(one.inputs(parts), rows) for one, rows in self._pick]
        ctrl, force = (np.concatenate([both[n][rows] for both, rows in known]) for n in (0, 1))
        return ctrl, force

    def felt(self, effect: Effect, target: str) -> Bools:
        """[N]: the intervals that an effect at a target may change: of what acts at a geom's
        contacts, those in which it may touch something."""
        if effect.kind != "geom" or mujoco.mjtDisableBit.mjDSBL_CONTACT not in effect.needs:
            return np.ones(len(self), bool)
        return self._touching[:, index_of(self.model, "geom", target)]

    @functools.cached_property
    def _touching(self) -> Bools:
        """[N, ngeom]: the declared scene's geoms that may touch something in an interval."""
        before, after = (self.qpos, self.qvel), (self.after_qpos, self.after_qvel)
        return may_touch(self.model, before, after, self.duration)

    def tangent(self, from_q: Floats, from_v: Floats, to_q: Floats, to_v: Floats) -> Floats:
        """Tangent vectors [N, 2 nv] from one set of states to another."""
        nv = self.model.nv
        result = np.empty((len(from_q), 2 * nv))
        if self.model.nq == nv:
            result[:, :nv] = to_q - from_q
        else:
            row = np.zeros(nv)
            for k in range(len(from_q)):
                mujoco.mj_differentiatePos(self.model, row, 1.0, from_q[k], to_q[k])
                result[k, :nv] = row
        result[:, nv:] = to_v - from_v
        return result

    def moved(self, direction: int, size: float) -> Floats:
        """The reference positions moved along one tangent direction."""
        if self.model.nq == self.model.nv:
            qpos = self.qpos.copy()
            qpos[:, direction] += size
            return qpos
        step = np.zeros(self.model.nv)
        step[direction] = size
        qpos = self.qpos.copy()
        for k in range(len(qpos)):
            mujoco.mj_integratePos(self.model, qpos[k], step, 1.0)
        return qpos


def linearize(flow: IntervalMap) -> Intervals:
    """Derivatives and defects of every interval, by forward differences."""
    nv, count = flow.model.nv, len(flow)
    base_q, base_v = flow.advance()
    a = np.empty((count, 2 * nv, 2 * nv))
    b = np.empty((count, 2 * nv, nv))
    for j in range(nv):
        q, v = flow.advance(qpos=flow.moved(j, _EPS))
        a[:, :, j] = flow.tangent(base_q, base_v, q, v) / _EPS
        qvel = flow.qvel.copy()
        qvel[:, j] += _EPS
        q, v = flow.advance(qvel=qvel)
        a[:, :, nv + j] = flow.tangent(base_q, base_v, q, v) / _EPS
    push = _force_scale(flow)
    for j in range(nv):
        force = np.zeros((count, nv))
        force[:, j] = push[j]
        q, v = flow.advance(force=force)
        b[:, :, j] = flow.tangent(base_q, base_v, q, v) / push[j]
    defect = flow.tangent(base_q, base_v, flow.after_qpos, flow.after_qvel)
    usable = np.isfinite(defect).all(axis=1) & np.isfinite(a).all(axis=(1, 2))
    return Intervals(flow.recording, flow.row, a, b, defect, np.asarray(usable))


def extrapolated(flow: IntervalMap, intervals: Intervals) -> Intervals:
    """With the defects of ever shorter timesteps, which follow from those of half of it, as the
    error of a step falls with its order (Richardson, Phil. Trans. R. Soc. A 210, 1911).

    Args:
      intervals: of this map.
    """
    defect = flow.tangent(*flow.advance(finer=2), flow.after_qpos, flow.after_qvel)
    rk4 = flow.variant.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    further = 1 / (1 - 0.5 ** (4 if rk4 else 1))
    found = intervals.defect + further * (defect - intervals.defect)
    return dataclasses.replace(
        intervals, defect=np.where(np.isfinite(found), found, intervals.defect)
    )


def _force_scale(flow: IntervalMap) -> Floats:
    """Forces that change velocities by about `_EPS` over an interval."""
    inertia = np.maximum(np.asarray(flow.model.dof_M0), 1e-9)
    return _EPS * inertia / float(np.median(flow.duration))


def missing_force(intervals: Intervals) -> Floats:
    """The constant generalized force over each interval that fits its defect best, [N, nv].

    Weighted by what a force does to velocities: positions hardly move within an interval.
    """
    nv = intervals.B.shape[2]
    b, d = intervals.B[:, nv:], intervals.defect[:, nv:]
    force = np.full((len(d), nv), np.nan)
    good = intervals.usable
    force[good] = np.linalg.solve(b[good], d[good][..., None])[..., 0]
    return force


def smoothed_force(force: Floats) -> Floats:
    """A missing force [N, nv], averaged over a few intervals; zero where it is not known."""
    kernel = np.ones(_SMOOTH) / _SMOOTH
    known = np.nan_to_num(force).T
    return np.stack([np.convolve(course, kernel, mode="same") for course in known], axis=1)


_SMOOTH = 7
"""Intervals: the force follows from differences of velocities, in which noise grows."""
