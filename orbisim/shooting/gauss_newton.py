"""Fits of parameters and window starts by Gauss-Newton.

Multiple shooting: each window starts at the reference plus a deviation that is estimated together
with the parameters, instead of at one noisy sample.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from orbisim.effects.measurement import TRUE, Measurement
from orbisim.errors import OrbiSimError
from orbisim.motion.hidden import Layout
from orbisim.shooting.fits import Fit, Hints, Unknown
from orbisim.shooting.shooter import Shooter, Variant
from orbisim.shooting.windows import KNOWN

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int64]


def gauss_newton(
    shooter: Shooter,
    build: Callable[[Floats], Variant],
    unknowns: Sequence[Unknown],
    *,
    start: Floats | None = None,
    hints: Hints | None = None,
    iterations: int = 6,
    tolerance: float = 1e-3,
    robust: float | None = None,
) -> Fit:
    """Fits parameters and window starts.

    Args:
      shooter: the windows. build: makes what is simulated from parameter values.
      unknowns: what to fit; may be empty.
      start: initial window starts; zero if None.
      hints: derivatives that are known in advance; finite differences where there are none.
      robust: residuals beyond this many standard deviations count linearly (Huber).
    """
    hints = hints or Hints()
    if hints.exact and start is None:
        values = np.array([u.start for u in unknowns])
        start = _approached(shooter, build(values), robust)
    problem = Problem(shooter, build, unknowns, hints, robust)
    return problem.solve(start, iterations, tolerance)


def _approached(shooter: Shooter, variant: Variant, robust: float | None) -> Floats:
    """Window starts from ever longer parts of the windows: the errors of a long window with impacts
    have many minima."""
    start = None
    for samples in _APPROACH:
        if samples < shooter.windows.length:
            hints = Hints(exact=True, quick=True)
            problem = Problem(shooter.first(samples), lambda _: variant, [], hints, robust)
            start = problem.solve(start, 4, 1e-2).start
    return np.zeros((len(shooter), 2 * shooter.nv)) if start is None else start


_APPROACH = (6, 15, 30)


def start_derivatives(shooter: Shooter, variant: Variant, start: Floats) -> Floats:
    """Derivatives of the weighted data by the window starts, [W, data, 2 nv]."""
    problem = Problem(shooter, lambda _: variant, [], Hints(), None)
    return problem.start_jacobian(problem.trial(np.zeros(0), start))


def proposed(
    shooter: Shooter,
    build: Callable[[Floats], Variant],
    unknowns: Sequence[Unknown],
    hints: Hints,
    start: Floats,
    robust: float | None,
) -> Floats:
    """[P]: the first step of a fit's parameters, within their bounds, from window starts [W, 2 nv]
    that are the best for where they begin."""
    problem = Problem(shooter, build, unknowns, hints, robust)
    values = np.clip(problem.begin, problem.low, problem.high)
    here = problem.trial(values, problem.widened(values, start))
    problem.scale = problem.half(here.cost)
    left, weighted = problem.shares(here, problem.slopes(here), problem.start_jacobian(here))
    step = problem.parameter_step(values, left, weighted, _DAMPED)
    return np.asarray(np.clip(values + step, problem.low, problem.high) - values)


class Problem:
    """Parameters and window starts to fit, and the steps towards the fit."""

    def __init__(
        self,
        shooter: Shooter,
        build: Callable[[Floats], Variant],
        unknowns: Sequence[Unknown],
        hints: Hints,
        robust: float | None,
    ) -> None:
        self.shooter, self.build, self.unknowns = shooter, build, list(unknowns)
        self.begin = np.array([u.start for u in unknowns])
        self.low = np.array([u.low for u in unknowns])
        self.high = np.array([u.high for u in unknowns])
        self.centre = np.array([u.centre for u in unknowns])
        self.precision = np.array([u.precision for u in unknowns])
        self.hints, self.robust = hints, robust
        self.scale = hints.lenient

    def solve(self, start: Floats | None, iterations: int, tolerance: float) -> Fit:
        """Goes downhill until steps bring little.

        Args:
          start: [W, 2 nv] window starts, zero if None. tolerance: share of the cost that is little.
        """
        shooter = self.shooter
        values = np.clip(self.begin, self.low, self.high)
        xi = self.widened(values, start)
        here = self.trial(values, xi)
        for other in [] if self.hints.near else self._others(values, xi, start is not None):
            here = self._better(here, self.trial(values, other))
        self.scale = self.half(here.cost)
        damping, brakes = _DAMPED, np.full(len(shooter), 1e-9)
        free = self.hints.free
        hinted = free is not None and free.shape[2] == xi.shape[1]
        known_free, rough = free if hinted else None, self.hints.rough
        free = self.start_jacobian(here) if known_free is None else known_free
        slopes, stale = self.slopes(here), np.zeros(len(shooter), bool)
        aged = np.zeros_like(stale)  # windows whose derivatives are of before the last steps
        active = np.ones(len(shooter), bool)
        hints, iteration = self.hints, 0
        again = (hints.exact or hints.rough) and not hints.quick
        ended = False
        while True:
            if ended or iteration >= iterations:
                retried = self._retried(here) if again else None
                if retried is None:
                    break
                iterations, again, hinted, ended = iterations + 3, False, False, False
                stale |= self._stale(here, retried, slopes, free)
                here, active = retried, np.ones(len(shooter), bool)
                free = self._fresh(free, self.start_jacobian, here, stale)
            slopes = self._fresh(slopes, self.slopes, here, stale)
            aged, stale = aged & ~stale, np.zeros_like(stale)
            if hinted and known_free is not None and not rough:
                free = shooter.read_late(known_free, here.measurement)
            found = self._search(here, slopes, free, damping, brakes, active)
            if found is None:
                ended = not hinted
                if hinted:  # the hint was no good
                    hinted, free = False, self.start_jacobian(here)
                continue
            if not self.unknowns:  # windows are independent of each other
                active = here.cost - found.cost > tolerance * here.cost
            before, after = self.total(here), self.total(found)
            gain = (before - after) / max(before, 1e-300)
            stale = self._stale(here, found, slopes, free)
            here, damping = found, max(damping / 10, 1e-9)
            iteration += 1
            if gain < tolerance and not (hinted and rough):
                ended = True
                stale[:] = False  # so short a step hardly changes derivatives
                continue
            if hinted and rough and (gain < 0.2 or iteration == 2):
                hinted, free = False, self.start_jacobian(here)
            elif not hinted and (self.hints.exact or iteration == 2):
                free = self._fresh(free, self.start_jacobian, here, stale)
            stale |= any(one.stepwise for one in self.unknowns)
            aged = np.full_like(stale, len(self.unknowns) > 1)  # steps test one direction only
        stale |= aged
        slopes = slopes if self.hints.quick else self._fresh(slopes, self.slopes, here, stale)
        return self._result(here, free, slopes)

    def widened(self, values: Floats, start: Floats | None) -> Floats:
        """Window starts with room for the joints that effects have added."""
        shooter = self.shooter
        added = self.build(values).scene.model.nv - shooter.nv
        xi = np.zeros((len(shooter), 2 * shooter.nv + 2 * added))
        if start is not None:
            width = 2 * shooter.nv if start.shape[1] != xi.shape[1] else xi.shape[1]
            xi[:, :width] = start[:, :width]
        return xi

    def _retried(self, here: Trial) -> Trial | None:
        """With the few windows that fit much worse than all others approached anew; None if in vain
        or if most fit badly."""
        means = self._mean(here.cost)
        bad = means > _BAD
        hidden = here.xi.shape[1] != 2 * self.shooter.nv
        if hidden or not bad.any() or float(np.median(means)) > _BAD:
            return None
        part = self.shooter.some(np.flatnonzero(bad))
        xi = here.xi.copy()
        xi[bad] = _approached(part, self.build(here.values), self.robust)
        found = self._better(self.trial(here.values, xi, bad, here), here)
        return found if self.total(found) < 0.99 * self.total(here) else None

    def _others(self, values: Floats, xi: Floats, known: bool) -> list[Floats]:
        """Other starts that may be better.

        Args:
          known: whether `xi` was given.
        """
        others = [np.zeros_like(xi)] if known and xi.any() else []
        if self.hints.rough or self.hints.exact:
            others.append(self._measured(xi))
            others += self._read(values, [xi, *others])
        return [*others, *self._ends(values, xi)]

    def _measured(self, xi: Floats) -> Floats:
        """Starts at the first sample as it was measured: smoothing blurs impacts."""
        found = np.zeros_like(xi)
        found[:, : 2 * self.shooter.nv] = self.shooter.first_seen
        return found

    def _read(self, values: Floats, starts: Sequence[Floats]) -> list[Floats]:
        """The same as readings of a sensor with an offset or a scale; nothing without one. Through
        impacts a fit does not find that all windows start elsewhere."""
        measurement, nv = self.build(values).measurement, self.shooter.nv
        if measurement.bias is None or measurement.scale is None:
            return []
        reference, found = self.shooter.absolute[:, 0], []
        for start in starts:
            truth = (reference + start[:, : 2 * nv] - measurement.bias) / measurement.scale
            moved = start.copy()
            moved[:, : 2 * nv] = truth - reference
            found.append(moved)
        return found

    def _ends(self, values: Floats, xi: Floats) -> list[Floats]:
        """Starts with the play of added joints taken up on either side."""
        model, declared = self.build(values).scene.model, self.shooter.declared.model
        found: list[Floats] = []
        place = Layout(declared, model) if model.nv > declared.nv else None
        for k, dof in enumerate([] if place is None else place.hidden_v):
            joint = int(model.dof_jntid[dof])
            if model.jnt_limited[joint]:
                for end in model.jnt_range[joint]:
                    moved = xi.copy()
                    moved[:, 2 * self.shooter.nv + k] = end
                    found.append(moved)
        return found

    def trial(
        self, values: Floats, xi: Floats, only: Bools | None = None, others: Trial | None = None
    ) -> Trial:
        """Simulates parameters and starts.

        Args:
          only: [W] the windows to simulate; all if None. others: where the other windows are from.
        """
        variant = self.build(values)
        simulated = self.shooter.simulate(variant, xi, only)
        if only is not None and others is not None:
            simulated = np.where(only[:, None, None], simulated, others.simulated)
            xi = np.where(only[:, None], xi, others.xi)
        residual = self.shooter.residual(simulated)
        cost = self.window_costs(residual)
        penalty = self.penalty(values)
        return Trial(values, xi, simulated, residual, cost, penalty, variant.measurement)

    def _search(
        self,
        here: Trial,
        slopes: Floats,
        free: Floats,
        damping: float,
        brakes: Floats,
        active: Bools,
    ) -> Trial | None:
        """The first step, ever shorter, that lowers the cost; windows it worsens stay behind."""
        for _ in range(_SHORTER):
            step, moves = self._step(here, slopes, free, damping, brakes)
            values = np.clip(here.values + step, self.low, self.high)
            try:
                trial = self.trial(values, here.xi + moves, active, here)
            except OrbiSimError:  # no such scene: a negative inertia, say
                damping = max(_REFUSED * damping, _REFUSED * 1e-3)
                continue
            worse = trial.cost > here.cost
            brakes[worse] = np.maximum(brakes[worse] * 100, 1e-3)
            brakes[~worse] = np.maximum(brakes[~worse] / 10, 1e-12)
            now = self.total(here)
            if worse.any() and (self.total(trial) >= now or self.hints.exact):
                stay = self.trial(values, here.xi, worse, trial) if self.unknowns else here
                trial = self._better(trial, stay)
            if self.total(trial) < now:
                return trial
            damping = max(damping * 10, 1e-3)
        return None

    def _better(self, one: Trial, other: Trial) -> Trial:
        """Window by window the better of two trials of the same parameters."""
        keep = one.cost <= other.cost
        pick = keep.reshape(-1, 1)
        return Trial(
            one.values,
            np.where(pick, one.xi, other.xi),
            np.where(pick[..., None], one.simulated, other.simulated),
            np.where(pick, one.residual, other.residual),
            np.where(keep, one.cost, other.cost),
            one.penalty,
            one.measurement,
        )

    def weights(self, residual: Floats) -> Floats:
        """[W, data]: by which squares count (Huber's loss)."""
        if self.robust is None:
            return np.ones_like(residual)
        size = np.abs(residual)
        return np.where(size > self.robust, self.robust / np.maximum(size, 1e-300), 1.0)

    def window_costs(self, residual: Floats) -> Floats:
        """[W]: what each window's residual costs."""
        if self.robust is None:
            return np.asarray((residual**2).sum(axis=1))
        size, k = np.abs(residual), self.robust
        return np.asarray(np.where(size <= k, size**2, 2 * k * size - k**2).sum(axis=1))

    def trust(self, cost: Floats) -> Floats:
        """[W]: by which windows count for the unknowns; 1 where they fit. As with residuals of
        which each window has its own scale (log-likelihood of a Student's t; Lange, Little and
        Taylor, J. Am. Stat. Assoc. 84, 1989): no start brings some impacts about, and one such
        window must not outweigh all others."""
        if not self.scale:
            return np.ones(len(cost))
        return np.asarray(1.0 / (1.0 + self._mean(cost) / self.scale))

    def half(self, cost: Floats) -> float:
        """Mean square at which a window counts half for the unknowns; 0 if all count alike."""
        return self.hints.lenient * max(1.0, float(np.median(self._mean(cost))))

    def _mean(self, cost: Floats) -> Floats:
        """[W]: cost of each datum."""
        return np.asarray(cost / np.maximum(self.shooter.data, 1))

    def total(self, trial: Trial) -> float:
        """What a fit makes least."""
        scale = self.scale
        if not scale:
            return trial.total
        grown = scale * np.log1p(self._mean(trial.cost) / scale)
        return float((self.shooter.data * grown).sum()) + trial.penalty

    def penalty(self, values: Floats) -> float:
        """What the priors charge."""
        return float((self.precision * (values - self.centre) ** 2).sum())

    def slopes(self, here: Trial, only: Bools | None = None) -> Floats:
        """Derivatives of the weighted simulated data by the parameters, [W, data, P].

        Args:
          only: [W] the windows in which they are wanted; all if None. Of others they are zero.
        """
        values = here.values
        slopes = np.zeros((*here.residual.shape, len(values)))
        if only is not None and not only.all():
            which = np.flatnonzero(only)
            slopes[which] = self._some(which).slopes(here.some(which))
            return slopes
        for p, known in self.hints.slopes.items():
            slopes[..., p] = known
        steps = {
            p: self._step_by(here, p, self._width(p, float(values[p])))
            or unknown.step_from(values[p])
            for p, unknown in enumerate(self.unknowns)
            if p not in self.hints.slopes
        }
        changes = self._changes(here, steps)
        if self.shooter.whitening is not None:
            self._widen(here, steps, changes)
        for p, change in changes.items():
            slopes[..., p] = change / steps[p]
        return slopes

    def _some(self, which: Ints) -> Problem:
        """The same with some of the windows."""
        part, known = copy.copy(self), self.hints.slopes
        part.shooter = self.shooter.some(which)
        part.hints = dataclasses.replace(
            self.hints, free=None, slopes={p: values[which] for p, values in known.items()}
        )
        return part

    def _width(self, p: int, value: float) -> float:
        """Of the difference by a parameter: its step, or, where impacts scatter, a tenth of what it
        is and as much as the data feel (`_widen`)."""
        one = self.unknowns[p]
        if self.shooter.whitening is None:
            return one.step
        return max(one.step, min(_TENTH * abs(value), one.widest or 0.0))

    def _step_by(self, here: Trial, p: int, width: float) -> float | None:
        """A difference by a parameter so wide, to one side or the other; None if neither leads to a
        possible scene (a negative inertia, say)."""
        step = self.unknowns[p].step_from(float(here.values[p]), width)
        if self.shooter.whitening is None:
            return step
        for one in (step, -step):
            moved = here.values + one * (np.arange(len(here.values)) == p)
            if self.low[p] <= moved[p] <= self.high[p]:
                with contextlib.suppress(OrbiSimError):
                    self.build(moved)
                    return one
        return None

    def _changes(self, here: Trial, steps: Mapping[int, float]) -> dict[int, Floats]:
        """By how much the weighted simulated data change over steps of some parameters."""
        base = self.shooter.scaled(here.simulated)
        number = np.arange(len(here.values))
        variants = [self.build(here.values + step * (number == p)) for p, step in steps.items()]
        runs = self.shooter.simulate_each(variants, here.xi)
        scaled = (self.shooter.scaled(after) - base for after in runs)
        return dict(zip(steps, scaled, strict=True))

    def _widen(self, here: Trial, steps: dict[int, float], changes: dict[int, Floats]) -> None:
        """Steps as wide as the data feel, where impacts scatter, with what changes over them: a
        difference over less is that of one impact's details."""
        for _ in range(_WIDENED):
            more: dict[int, float] = {}
            for p, change in changes.items():
                each = np.sqrt((change**2).sum(axis=1) / np.maximum(self.shooter.data, 1))
                felt, now = float(np.quantile(each, _FEW_FEEL)), abs(steps[p])
                wider = now * min(_FELT / max(felt, 1e-12), _AT_A_TIME)
                wider = min(wider, max(self.unknowns[p].widest or 0.0, now))
                if felt < _FELT / 2 and wider > now:
                    step = self._step_by(here, p, wider)
                    more |= {} if step is None else {p: step}
            if not more:
                break
            steps |= more
            changes |= self._changes(here, more)

    def _stale(self, before: Trial, after: Trial, slopes: Floats, free: Floats) -> Bools:
        """[W]: windows that a step has changed otherwise than derivatives foresaw: these have to be
        taken anew there."""
        step, moves = after.values - before.values, after.xi - before.xi
        change = after.residual - before.residual
        off = change + slopes @ step + np.einsum("wdf,wf->wd", free, moves)
        size = np.maximum(np.linalg.norm(change, axis=1), np.sqrt(self.shooter.data))
        return np.asarray(~(np.linalg.norm(off, axis=1) <= _STALE * size))

    def _fresh(
        self, known: Floats, derivatives: Callable[[Trial, Bools], Floats], here: Trial, anew: Bools
    ) -> Floats:
        """Derivatives, of some windows taken anew."""
        if not anew.any() or not known.shape[2]:
            return known
        return np.where(anew[:, None, None], derivatives(here, anew), known)

    def start_jacobian(self, here: Trial, only: Bools | None = None) -> Floats:
        """Derivatives of the weighted simulated data by the window starts, [W, data, 2 nv]."""
        shooter, count = self.shooter, len(self.shooter)
        which = np.arange(count) if only is None else np.flatnonzero(only)
        steps = self._start_steps(here.xi.shape[1])
        runs = shooter.moved(self.build(here.values), here.xi, steps, which)
        part, base = shooter.some(which), shooter.scaled(here.simulated)
        jacobian = np.zeros((*base.shape, len(runs)))
        for j, after in enumerate(runs):
            jacobian[which, :, j] = (part.scaled(after) - base[which]) / steps[j]
        return np.clip(jacobian, -1e12, 1e12)

    def _start_steps(self, columns: int) -> Floats:
        """[columns]: steps of differences by starts. Where impacts scatter, over as much as a start
        is unknown: a difference over less is that of one impact's details."""
        steps = np.full(columns, _START_STEP)
        if self.shooter.whitening is not None:
            size = self.shooter.start_size
            steps[: len(size)] = np.maximum(KNOWN * size, _START_STEP)
        return steps

    def projected(
        self, residual: Floats, slopes: Floats, free: Floats, weighed_by: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """Residuals and slopes without what the starts explain.

        Args:
          weighed_by: [W, data] residuals that give the weights; `residual` if None.
        """
        root = np.sqrt(self.weights(residual if weighed_by is None else weighed_by))[..., None]
        weighted = slopes * root
        left = residual * root[..., 0]
        basis = np.linalg.qr(free * root)[0]
        left = left - np.einsum("wdf,wf->wd", basis, np.einsum("wdf,wd->wf", basis, left))
        inner = np.einsum("wdf,wdp->wfp", basis, weighted)
        return left, weighted - np.einsum("wdf,wfp->wdp", basis, inner)

    def shares(self, here: Trial, slopes: Floats, free: Floats) -> tuple[Floats, Floats]:
        """As `projected`, windows weighed by how far they are trusted."""
        root = np.sqrt(self.trust(here.cost))[:, None]
        left, weighted = self.projected(here.residual, slopes, free)
        return left * root, weighted * root[..., None]

    def parameter_step(
        self, values: Floats, left: Floats, weighted: Floats, damping: float
    ) -> Floats:
        """[P]: the damped step of the unknowns, zero where it would leave the bounds, and for those
        whose slopes overflow: through impacts a difference over a small step may be that of a
        motion that flies off.

        Args:
          left, weighted: residuals and slopes without what the starts explain.
        """
        count = len(values)
        if not count:
            return np.zeros(0)
        gram = np.einsum("wdp,wdq->pq", weighted, weighted) + np.diag(self.precision)
        moment = np.einsum("wdp,wd->p", weighted, left)
        moment = moment - self.precision * (values - self.centre)
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        known = np.flatnonzero((np.diag(gram) < _HUGE**2) & np.isfinite(moment))
        within = np.ix_(known, known)
        scaled = gram[within] / np.outer(scale, scale)[within] + damping * np.eye(len(known))
        step = np.zeros(count)
        step[known] = np.linalg.lstsq(scaled, (moment / scale)[known], rcond=1e-10)[0]
        step[known] /= scale[known]
        blocked = ((values >= self.high) & (step > 0)) | ((values <= self.low) & (step < 0))
        step[blocked] = 0.0
        return np.asarray(step)

    def _step(
        self, here: Trial, slopes: Floats, free: Floats, damping: float, brakes: Floats
    ) -> tuple[Floats, Floats]:
        residual = here.residual
        left, weighted = self.shares(here, slopes, free)
        step = self.parameter_step(here.values, left, weighted, damping)
        root = np.sqrt(self.weights(residual))
        wanted = (residual - slopes @ step) * root
        return step, least_squares(free * root[..., None], wanted, brakes)

    def _result(self, here: Trial, free: Floats, slopes: Floats) -> Fit:
        values, xi, residual = here.values, here.xi, here.residual
        if self.hints.quick:
            slopes = np.zeros((*residual.shape, len(values)))
        left, weighted = self.shares(here, slopes, free)
        information = np.einsum("wdp,wdq->wpq", weighted, weighted)
        score = np.einsum("wdp,wd->wp", weighted, left)
        # a window whose slopes overflow (see `parameter_step`) says nothing
        told = (np.abs(information) < _HUGE).all(axis=(1, 2)) & (np.abs(score) < _HUGE).all(axis=1)
        information[~told], score[~told] = 0.0, 0.0
        gram = information.sum(axis=0) + np.diag(self.precision)
        trust, square = self.trust(here.cost), float(here.cost.sum())
        fitted = len(values) + free.shape[2] * len(residual)
        count = max(self.shooter.count - fitted, 1)
        covariance = np.linalg.pinv(gram, rcond=1e-12) if len(values) else np.zeros((0, 0))
        return Fit(
            values=values,
            start=xi,
            square=square,
            count=count,
            covariance=covariance * max(float(trust @ here.cost) / count, float(trust.mean())),
            residual=residual,
            per_window=self.window_costs(residual),
            information=information,
            score=score,
            recording=self.shooter.recording,
            prior=np.diag(self.precision),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Trial:
    """Parameters and starts, simulated, and how that is measured. cost: [W] of each window.
    penalty: of the priors."""

    values: Floats
    xi: Floats
    simulated: Floats
    residual: Floats
    cost: Floats
    penalty: float
    measurement: Measurement = TRUE

    def some(self, which: Ints) -> Trial:
        """Of some of the windows."""
        names = ("xi", "simulated", "residual", "cost")
        return dataclasses.replace(self, **{name: getattr(self, name)[which] for name in names})

    @property
    def total(self) -> float:
        """Cost of all windows and of the priors."""
        return float(self.cost.sum()) + self.penalty


def least_squares(matrix: Floats, wanted: Floats, brakes: Floats) -> Floats:
    """Window by window, with columns scaled and damped; what changes nothing stays put, and so does
    a window that overflows."""
    whole = np.asarray(np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(wanted).all(axis=1))
    matrix = np.where(whole[:, None, None], matrix, 0.0)
    wanted = np.where(whole[:, None], wanted, 0.0)
    scale = np.maximum(np.linalg.norm(matrix, axis=1), 1e-300)
    u, s, vt = np.linalg.svd(matrix / scale[:, None, :], full_matrices=False)
    felt = s > 1e-8 * s[:, :1]
    inverse = np.where(felt, s / np.where(felt, s**2 + brakes[:, None], 1.0), 0.0)
    inner = np.einsum("wdk,wd->wk", u, wanted) * inverse
    return np.asarray(np.einsum("wkf,wk->wf", vt, inner) / scale)


_HUGE = 1e150
"""Of what a window says of parameters: squares of such numbers are finite, larger ones overflow."""
_START_STEP = 1e-6
"""Step of differences by starts: well above the rounding of a run, well below what bends it."""
_TENTH = 0.1
"""Of a number: the cost through impacts is rugged, and a slope over less holds no further."""
_FELT = 2.0
"""Change of a window's data over a difference that they feel, over the noise: details of impacts
change them by up to the noise, however little a number is moved."""
_FEW_FEEL = 0.75
"""Share of the windows that may feel less: a body at rest feels little."""
_WIDENED, _AT_A_TIME = 4, 1e3
"""How often a difference is widened at most, and by how much at once."""
_DAMPED = 1e-4
"""Of the parameters' first step, over their information."""
_SHORTER = 7
"""How many steps are tried, each damped ten times as much: friction that makes a joint stick hardly
grows where it does not yet, so that the first may be ten times too long."""
_REFUSED = 100.0
"""By how much a step is damped that leads to no possible scene."""
_STALE = 0.1
"""Share of a window's change, or of its noise, that derivatives did not foresee, from which on they
are taken anew: below it, the next step with the old ones leaves a tenth of what it is to remove."""
_BAD = 4.0
"""Mean square of a window that fits badly where most do not: its start is approached anew."""
