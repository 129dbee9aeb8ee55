"""Free-running simulation of windows from estimated starts, and fits by Gauss-Newton.

Multiple shooting: each window starts at the reference plus a deviation that is estimated together
with the parameters, instead of at one noisy sample.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import mujoco
import mujoco.batch
import numpy as np
import numpy.typing as npt
from orbisim_mujoco.stepping import step_batch

from orbisim.diagnosis.hidden import Layout, carried_along
from orbisim.diagnosis.linear import Intervals
from orbisim.diagnosis.regress import Windows
from orbisim.diagnosis.samples import Samples
from orbisim.effects.carry import hooks_of
from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


class Shooter:
    """Simulates windows of recordings.

    Args:
      declared: the scene as declared, whose coordinates the samples have.
      samples: the recordings. intervals: their sampling intervals. windows: what to simulate.
      noise: standard deviations of positions and velocities, each [nv].
    """

    def __init__(
        self,
        declared: Scene,
        samples: Sequence[Samples],
        intervals: Intervals,
        windows: Windows,
        noise: tuple[Floats, Floats],
    ) -> None:
        self.declared, self.samples, self.windows = declared, samples, windows
        self.nv = declared.model.nv
        rows = [
            (samples[i], int(intervals.row[f]))
            for i, f in zip(windows.recording, windows.first, strict=True)
        ]
        k = windows.length
        self.row = np.array([r for _, r in rows], np.int64)
        self.time = np.array([s.time[r : r + k + 1] for s, r in rows])
        self.qpos = np.array([s.qpos[r : r + k + 1] for s, r in rows])
        self.qvel = np.array([s.qvel[r : r + k + 1] for s, r in rows])
        self.ctrl = np.array([s.ctrl[r : r + k] for s, r in rows])
        self.force = np.array([s.force[r : r + k] for s, r in rows])
        deviation = np.array(
            [np.concatenate([s.dq[r : r + k + 1], s.dv[r : r + k + 1]], axis=1) for s, r in rows]
        )
        sigma = np.concatenate(noise)
        self.measured = np.flatnonzero(np.isfinite(sigma))
        self.weight = 1.0 / sigma[self.measured]
        picked = deviation[:, :, self.measured]
        self.seen = np.isfinite(picked)
        self.target = np.where(self.seen, picked, 0.0) * self.weight
        step = float(declared.model.opt.timestep)
        lengths = np.diff(self.time, axis=1)
        self.substeps = np.maximum(1, np.ceil(np.median(lengths) / step - 1e-6)).astype(int)

    def __len__(self) -> int:
        return len(self.windows)

    @property
    def count(self) -> int:
        """Number of data."""
        return int(self.seen.sum())

    def simulate(self, variant: Scene, start: Floats) -> Floats:
        """Deviations from the reference [W, K + 1, 2 nv] of free runs from the starts.

        Args:
          variant: the scene to simulate. start: [W, 2 nv] deviation at each window's start.
        """
        model = variant.model
        place = Layout(self.declared.model, model)
        batch = mujoco.batch.Batch(model, len(self), 0)
        qpos, qvel = self._moved(start)
        batch.bind("qpos")[:] = model.qpos0
        batch.bind("qpos")[:, place.q] = qpos
        batch.bind("qvel")[:] = 0.0
        batch.bind("qvel")[:, place.v] = qvel
        batch.bind("time")[:] = self.time[:, 0]
        if model.na or model.nhistory:
            act, history = self._hidden(model)
            batch.bind("act")[:], batch.bind("history")[:] = act, history
        timestep = batch.expand("opt.timestep")
        hooks = hooks_of(model)
        out = np.empty((len(self), self.windows.length + 1, 2 * self.nv))
        out[:, 0] = start
        applied = batch.bind("qfrc_applied")
        for k in range(self.windows.length):
            length = self.time[:, k + 1] - self.time[:, k]
            timestep[:] = (length / self.substeps).reshape(timestep.shape)
            applied[:, place.v] = self.force[:, k]
            step_batch(model, batch, hooks, self.ctrl[:, k], int(self.substeps))
            here_q, here_v = batch.bind("qpos")[:, place.q], batch.bind("qvel")[:, place.v]
            out[:, k + 1] = self._deviation(k + 1, here_q, here_v)
        return out

    def residual(self, simulated: Floats) -> Floats:
        """Weighted measured minus simulated deviations [W, data]; zero where not measured."""
        values = simulated[:, :, self.measured] * self.weight
        values = np.where(self.seen, self.target - values, 0.0)
        lost = ~np.isfinite(values)
        values[lost] = _LOST
        return np.clip(values, -_LOST, _LOST).reshape(len(self), -1)

    def _moved(self, start: Floats) -> tuple[Floats, Floats]:
        qpos, qvel = self.qpos[:, 0].copy(), self.qvel[:, 0] + start[:, self.nv :]
        if qpos.shape[1] == self.nv:
            return qpos + start[:, : self.nv], qvel
        for w in range(len(qpos)):
            delta = np.ascontiguousarray(start[w, : self.nv])
            mujoco.mj_integratePos(self.declared.model, qpos[w], delta, 1.0)
        return qpos, qvel

    def _deviation(self, k: int, qpos: Floats, qvel: Floats) -> Floats:
        reference = self.qpos[:, k]
        if qpos.shape[1] == self.nv:
            dq = qpos - reference
        else:
            dq = np.zeros((len(qpos), self.nv))
            for w in range(len(qpos)):
                here = np.ascontiguousarray(qpos[w])
                mujoco.mj_differentiatePos(self.declared.model, dq[w], 1.0, reference[w], here)
        return np.concatenate([dq, qvel - self.qvel[:, k]], axis=1)

    def _hidden(self, model: mujoco.MjModel) -> tuple[Floats, Floats]:
        """Activations and delay buffers at the windows' starts."""
        every = [carried_along(s, self.declared.model, model) for s in self.samples]
        at = list(zip(self.windows.recording, self.row, strict=True))
        return (
            np.array([every[i][0][r] for i, r in at]),
            np.array([every[i][1][r] for i, r in at]),
        )


_LOST = 1e6

# ---------------------------------------------------------------------------------------------
# Gauss-Newton


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """A fit of parameters and starts.

    Attributes:
      values: the parameters. start: [W, 2 nv] deviations at the windows' starts.
      square: sum of squared weighted residuals. count: data minus fitted numbers.
      covariance: [P, P] of the parameters, by the Jacobian.
      residual: [W, data] weighted. per_window: [W] sums of squares.
      information: [W, P, P] and score [W, P]: each window's share, for the bootstrap.
    """

    values: Floats
    start: Floats
    square: float
    count: int
    covariance: Floats
    residual: Floats
    per_window: Floats
    information: Floats
    score: Floats

    @property
    def ratio(self) -> float:
        """Residual over noise: root of the reduced sum of squares."""
        return float(np.sqrt(self.square / max(self.count, 1)))


@dataclasses.dataclass(frozen=True)
class Unknown:
    """One fitted number.

    Attributes:
      name: for messages. start: where to begin. low, high: bounds. step: for differences.
    """

    name: str
    start: float
    low: float
    high: float
    step: float


def gauss_newton(
    shooter: Shooter,
    build: Callable[[Floats], Scene],
    unknowns: Sequence[Unknown],
    *,
    start: Floats | None = None,
    prior: Floats | None = None,
    iterations: int = 6,
    tolerance: float = 1e-3,
    robust: float | None = None,
    starts_free: bool = True,
) -> Fit:
    """Fits parameters and window starts.

    Args:
      shooter: the windows. build: makes the scene for parameter values.
      unknowns: what to fit; may be empty.
      start: initial window starts; zero if None.
      prior: [P] standard deviations about the starting values; None for none.
      robust: residuals beyond this many standard deviations count linearly (Huber).
      starts_free: whether window starts are fitted.
    """
    problem = _Problem(shooter, build, unknowns, prior, robust, starts_free)
    return problem.solve(start, iterations, tolerance)


class _Problem:
    def __init__(
        self,
        shooter: Shooter,
        build: Callable[[Floats], Scene],
        unknowns: Sequence[Unknown],
        prior: Floats | None,
        robust: float | None,
        starts_free: bool,
    ) -> None:
        self.shooter, self.build, self.unknowns = shooter, build, list(unknowns)
        self.begin = np.array([u.start for u in unknowns])
        self.low = np.array([u.low for u in unknowns])
        self.high = np.array([u.high for u in unknowns])
        self.prior, self.robust, self.starts_free = prior, robust, starts_free

    def solve(self, start: Floats | None, iterations: int, tolerance: float) -> Fit:
        shooter = self.shooter
        values = np.clip(self.begin, self.low, self.high)
        xi = np.zeros((len(shooter), 2 * shooter.nv)) if start is None else start.copy()
        simulated = shooter.simulate(self.build(values), xi)
        residual = shooter.residual(simulated)
        cost = self._cost(residual, values)
        damping = 1e-4
        free = self._start_jacobian(values, xi, simulated)
        for iteration in range(iterations):
            if iteration == 2 and self.starts_free:
                free = self._start_jacobian(values, xi, simulated)
            slopes = self._slopes(values, xi, simulated)
            improved = False
            for _ in range(5):
                step, moves = self._step(residual, slopes, free, values, damping)
                trial = np.clip(values + step, self.low, self.high)
                trial_xi = xi + moves
                trial_sim = shooter.simulate(self.build(trial), trial_xi)
                trial_residual = shooter.residual(trial_sim)
                trial_cost = self._cost(trial_residual, trial)
                if trial_cost < cost:
                    improved = True
                    break
                damping = max(damping * 10, 1e-3)
            if not improved:
                break
            gain = (cost - trial_cost) / max(cost, 1e-300)
            values, xi, simulated, residual, cost = (
                trial, trial_xi, trial_sim, trial_residual, trial_cost,
            )  # fmt: skip
            damping = max(damping / 10, 1e-9)
            if gain < tolerance:
                break
        return self._result(values, xi, simulated, residual, free)

    def _weights(self, residual: Floats) -> Floats:
        if self.robust is None:
            return np.ones_like(residual)
        size = np.abs(residual)
        return np.where(size > self.robust, self.robust / np.maximum(size, 1e-300), 1.0)

    def _cost(self, residual: Floats, values: Floats) -> float:
        if self.robust is None:
            cost = float((residual**2).sum())
        else:
            size, k = np.abs(residual), self.robust
            cost = float(np.where(size <= k, size**2, 2 * k * size - k**2).sum())
        if self.prior is not None:
            cost += float((((values - self.begin) / self.prior) ** 2).sum())
        return cost

    def _slopes(self, values: Floats, xi: Floats, simulated: Floats) -> Floats:
        """Derivatives of the weighted simulated data by the parameters, [W, data, P]."""
        base = self._scaled(simulated)
        slopes = np.zeros((*base.shape, len(values)))
        for p, unknown in enumerate(self.unknowns):
            step = unknown.step
            if values[p] + step > unknown.high:
                step = -step
            moved = values.copy()
            moved[p] += step
            after = self._scaled(self.shooter.simulate(self.build(moved), xi))
            slopes[..., p] = np.nan_to_num((after - base) / step)
        return slopes

    def _start_jacobian(self, values: Floats, xi: Floats, simulated: Floats) -> Floats:
        """Derivatives of the weighted simulated data by the window starts, [W, data, 2 nv]."""
        base = self._scaled(simulated)
        columns = 2 * self.shooter.nv if self.starts_free else 0
        jacobian = np.zeros((*base.shape, columns))
        scene = self.build(values)
        for j in range(columns):
            moved = xi.copy()
            moved[:, j] += _START_STEP
            after = self._scaled(self.shooter.simulate(scene, moved))
            jacobian[..., j] = np.nan_to_num((after - base) / _START_STEP)
        return np.clip(jacobian, -1e12, 1e12)

    def _scaled(self, simulated: Floats) -> Floats:
        shooter = self.shooter
        values = simulated[:, :, shooter.measured] * shooter.weight
        return np.asarray(np.where(shooter.seen, values, 0.0).reshape(len(shooter), -1))

    def _projected(
        self, residual: Floats, slopes: Floats, free: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Residuals and slopes without what the starts explain; and the starts' bases."""
        root = np.sqrt(self._weights(residual))[..., None]
        weighted_free, weighted = free * root, slopes * root
        left = residual * root[..., 0]
        if not free.shape[2]:
            return left, weighted, weighted_free
        basis = np.linalg.qr(weighted_free + 0.0)[0]
        left = left - np.einsum("wdf,wf->wd", basis, np.einsum("wdf,wd->wf", basis, left))
        inner = np.einsum("wdf,wdp->wfp", basis, weighted)
        weighted = weighted - np.einsum("wdf,wfp->wdp", basis, inner)
        return left, weighted, weighted_free

    def _step(
        self, residual: Floats, slopes: Floats, free: Floats, values: Floats, damping: float
    ) -> tuple[Floats, Floats]:
        left, weighted, _ = self._projected(residual, slopes, free)
        count = len(values)
        step = np.zeros(count)
        if count:
            gram = np.einsum("wdp,wdq->pq", weighted, weighted)
            moment = np.einsum("wdp,wd->p", weighted, left)
            if self.prior is not None:
                gram = gram + np.diag(1 / self.prior**2)
                moment = moment - (values - self.begin) / self.prior**2
            scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
            scaled = gram / np.outer(scale, scale) + damping * np.eye(count)
            step = np.linalg.lstsq(scaled, moment / scale, rcond=1e-10)[0] / scale
            blocked = ((values >= self.high) & (step > 0)) | ((values <= self.low) & (step < 0))
            step[blocked] = 0.0
        moves = np.zeros((len(residual), 2 * self.shooter.nv))
        if free.shape[2]:
            root = np.sqrt(self._weights(residual))
            wanted = (residual - slopes @ step) * root
            for w in range(len(residual)):
                matrix = free[w] * root[w][:, None]
                moves[w] = np.linalg.lstsq(matrix, wanted[w], rcond=1e-8)[0]
        return step, moves

    def _result(
        self, values: Floats, xi: Floats, simulated: Floats, residual: Floats, free: Floats
    ) -> Fit:
        slopes = self._slopes(values, xi, simulated)
        left, weighted, _ = self._projected(residual, slopes, free)
        information = np.einsum("wdp,wdq->wpq", weighted, weighted)
        score = np.einsum("wdp,wd->wp", weighted, left)
        gram = information.sum(axis=0)
        if self.prior is not None:
            gram = gram + np.diag(1 / self.prior**2)
        square = float((residual**2).sum())
        fitted = len(values) + (free.shape[2] * len(residual) if free.shape[2] else 0)
        count = max(self.shooter.count - fitted, 1)
        covariance = np.linalg.pinv(gram, rcond=1e-12) if len(values) else np.zeros((0, 0))
        return Fit(
            values=values,
            start=xi,
            square=square,
            count=count,
            covariance=covariance * max(square / count, 1.0),
            residual=residual,
            per_window=(residual**2).sum(axis=1),
            information=information,
            score=score,
        )


_START_STEP = 1e-6


def unknowns_of(
    names: Sequence[str], values: Mapping[str, float], bounds: Mapping[str, tuple[float, float]],
    scales: Mapping[str, float],
) -> list[Unknown]:  # fmt: skip
    """Fitted numbers with difference steps that fit their size."""
    found: list[Unknown] = []
    for name in names:
        value = float(values[name])
        low, high = bounds[name]
        size = max(abs(value), 0.05 * abs(scales[name]), 1e-12)
        found.append(Unknown(name, value, low, high, 1e-4 * size))
    return found
