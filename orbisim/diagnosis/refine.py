"""Fits of whole hypotheses by simulation, and how they fare on windows they have not seen."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.effects import find
from orbisim.errors import OrbiSimError
from orbisim.motion.linear import Intervals, linearize
from orbisim.shooting.bench import Bench
from orbisim.shooting.fits import Fit, Hints
from orbisim.shooting.gauss_newton import gauss_newton, start_derivatives
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.one_run import Own, glanced, own_slopes
from orbisim.shooting.retune import Tunable
from orbisim.shooting.shooter import Shooter, Variant
from orbisim.shooting.windows import Windows

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

_WEAK = 1e-7


@dataclasses.dataclass(frozen=True, eq=False)
class Judged:
    """A hypothesis, fitted and checked.

    Attributes:
      hypothesis: with fitted values. fit: on the windows it was fitted to.
      checked: [windows] mean squared weighted residual of each check window, starts fitted.
      ratio: residual over noise, on the fitted or on the check windows, whichever is larger.
      pooled: the same over all windows, with none left out.
      check_fit: window starts on the check windows.
      windows: those that it was fitted to. touching: whether bodies touch in the data.
      fitted: as `checked`, of the windows that it was fitted to.
    """

    hypothesis: Hypothesis
    fit: Fit
    checked: Floats
    ratio: float
    pooled: float
    check_fit: Fit
    windows: Windows
    touching: bool = False
    fitted: Floats = dataclasses.field(default_factory=lambda: np.zeros(0))

    @property
    def loss(self) -> float:
        """How badly windows are predicted, bad ones by their logarithm: of two fits of the same
        hypothesis, the one with less is better."""
        return float(np.log1p(np.concatenate([self.fitted, self.checked])).mean())


class Judge:
    """Fits and checks hypotheses on the same windows.

    Args:
      bench: the data.
      intervals: linear system along a scene close to what will be judged, for quick derivatives.
      tunables, columns: declared parameters and their effect on every interval [N, 2 nv, F]; not
        used where bodies touch, as chained through impacts it says little.
      most: at most so many windows are fitted (spread evenly), for speed; None for all.
      heavy: whether windows have one unknown scale and heavy tails, as where bodies touch, instead
        of the noise's: what is left on a real machine is model error.
    """

    def __init__(
        self,
        bench: Bench,
        intervals: Intervals,
        tunables: Sequence[Tunable] = (),
        columns: Floats | None = None,
        most: int | None = None,
        heavy: bool = False,
    ) -> None:
        self.bench = bench
        self.robust = _IMPACTS if bench.contacts else None
        self.heavy = heavy or bench.contacts
        self.fitted = bench.shooter(thinned(bench.fit, most))
        check = bench.check if bench.check.any() else bench.fit
        if (check == bench.fit).all():
            self.check = self.fitted
        else:
            self.check = bench.shooter(thinned(check, None if most is None else max(8, most // 2)))
        self._free: dict[int, Floats] = {}
        if not bench.contacts:
            self._free = {id(s): s.chained(intervals) for s in (self.fitted, self.check)}
        self._slopes: dict[Tunable, Floats] = {}
        if columns is not None and not bench.contacts:
            response = self.fitted.respond(intervals, columns)
            self._slopes = {one: response[..., f] for f, one in enumerate(tunables)}
        self._warm: dict[int, Floats] = {}
        self._own: Own | None = None
        self._told: tuple[Hypothesis, Floats] | None = None
        self._begun: Judged | None = None

    def begin_with(self, judged: Judged | None) -> None:
        """Takes an explanation's window starts, and what they do, as first guesses; if None, none
        where derivatives are known in advance, and else the last ones."""
        if judged is self._begun:
            return
        if judged is not None:
            self.start_from(judged)
        elif not self.bench.contacts:
            self._warm = {}
        self._begun = judged

    def judge(
        self,
        hypothesis: Hypothesis,
        iterations: int = 5,
        polish: bool = True,
        begin: Judged | None = None,
    ) -> Judged | None:
        """Fits the hypothesis' free parameters; None if it cannot be simulated.

        Args:
          polish: whether parameters that act in steps are searched, which takes long.
          begin: an explanation of the same windows whose starts are first guesses.
        """
        try:
            self.begin_with(begin)
            fitted, fit = self._fitted(hypothesis, iterations)
            if polish:
                fitted, fit = self._polish(fitted, fit)
            checked = fit if self.check is self.fitted else self.score(fitted, self.check)
        except (OrbiSimError, np.linalg.LinAlgError):
            return None
        means = _means(self.check, checked)
        fit_means = _means(self.fitted, fit)
        trimmed = bool(fitted.effects or fitted.factors)
        square = max(
            self._typical(self.fitted, fit_means, trimmed),
            self._typical(self.check, means, trimmed),
        )
        pooled = float(np.mean([*fit_means, *means]))
        return Judged(
            fitted, fit, means, float(np.sqrt(square)), float(np.sqrt(pooled)),
            checked, self.fitted.windows, self.bench.contacts, fit_means,
        )  # fmt: skip

    def _typical(self, shooter: Shooter, means: Floats, trimmed: bool = True) -> float:
        """Mean over windows; with contacts, without the worst few.

        Args:
          trimmed: whether any window may be left out, or only those that impacts cut short.
        """
        if not self.bench.contacts:
            return float(means.mean())
        may_go = np.ones(len(means), bool) if trimmed else shooter.windows.fragile()
        worst_first = np.flatnonzero(may_go)[np.argsort(-means[may_go])]
        kept = np.delete(means, worst_first[: round(_TRIMMED * len(means))])
        return float(kept.mean())

    def closer(self, judged: Judged, iterations: int = 5) -> Judged:
        """The hypothesis fitted again, if that is better: with what a window's start does along its
        own scene, then as differences show. Along the declared scene it may be quite another thing.
        Where bodies touch, only the latter.
        """
        kept = self._free, self._warm, self._own, self._told
        best = judged
        try:
            for own in (False,) if self.bench.contacts else (True, False):
                if best.ratio < _REACHED and not self.bench.contacts:
                    break
                again = self._judged_anew(best, own, iterations)
                if again is not None and again.loss < best.loss:
                    best = again
        finally:
            self._free, self._warm, self._own, self._told = kept
        return best

    def _judged_anew(self, judged: Judged, own: bool, iterations: int) -> Judged | None:
        self._free, self._warm, self._own, self._told = {}, {}, None, None
        if own:
            intervals = linearize(self.bench.flow(judged.hypothesis))
            self._free = {id(s): s.chained(intervals) for s in (self.fitted, self.check)}
        else:
            self.start_from(judged)
        return self.judge(judged.hypothesis, iterations)

    def glance(self, hypothesis: Hypothesis) -> float:
        """As `sized_glance`, without the size."""
        return self.sized_glance(hypothesis)[0]

    def sized_glance(self, hypothesis: Hypothesis) -> tuple[float, float]:
        """What a hypothesis would leave, at the price of one simulation: mean squared residual over
        every other window, with starts, the numbers of the hypothesis that `start_from` was told,
        and the size of the difference to that, corrected linearly, and this size; infinite if it
        cannot be simulated, or if `start_from` was not called before.
        """
        some = np.arange(len(self.fitted)) % 2 == 0 if len(self.fitted) >= _MANY else None
        left, size = self._glanced(hypothesis, some)
        return (np.inf if left is None else self._typical(self.fitted, left)), size

    def _glanced(self, hypothesis: Hypothesis, some: Bools | None) -> tuple[Floats | None, float]:
        """Mean square of some windows or all; None if that cannot be told; and the better size."""
        start, free = self._warm.get(id(self.fitted)), self._free.get(id(self.fitted))
        if start is None or free is None:
            return None, 1.0
        try:
            variant = hypothesis.variant(self.bench.scene)
            own = self._own_slopes()
            left, size = glanced(self.fitted, variant, start, free, self.robust, own, some)
        except (OrbiSimError, np.linalg.LinAlgError):
            return None, 1.0
        dof = np.maximum(self.fitted.data - 2 * self.fitted.nv, 1)
        return (left / dof)[slice(None) if some is None else some], size

    def tried(self, hypothesis: Hypothesis) -> float:
        """What one step of a fit leaves, over all windows; with derivatives by the numbers of the
        hypothesis that `start_from` was told as they are there."""
        try:
            fit = self._fit(hypothesis, 1, quick=True)
        except (OrbiSimError, np.linalg.LinAlgError):
            return np.inf
        return self._typical(self.fitted, _means(self.fitted, fit))

    def _own_slopes(self) -> Own | None:
        """What the numbers of the hypothesis change that `start_from` was told; where bodies touch
        alone, and not where joints were added."""
        known, self._told = self._told, None
        if known is not None:
            self._own = self._slopes_of(*known)
        return self._own

    def _slopes_of(self, hypothesis: Hypothesis, start: Floats) -> Own | None:
        if is_structural(hypothesis):
            return None
        declared = self.bench.scene

        def build(values: Floats) -> Variant:
            return hypothesis.at(declared, values).variant(declared)

        try:
            return own_slopes(self.fitted, build, hypothesis.unknowns(declared), start)
        except OrbiSimError:  # a difference step leads to no possible scene: glances do without
            return None

    def start_from(self, judged: Judged, fitted: Bools | None = None) -> None:
        """Takes a hypothesis' window starts, and what they do, as first guesses for others.

        Args:
          fitted: where all windows are fitted, which of them the hypothesis was fitted to; it was
            checked on the others. None if the windows are the same.
        """
        starts = {self.fitted: judged.fit.start, self.check: judged.check_fit.start}
        if fitted is not None:
            joined = np.zeros((len(fitted), judged.fit.start.shape[1]))
            if fitted.sum() != len(judged.fit.start) or len(fitted) != len(self.fitted):
                return  # some were left out for speed
            joined[fitted], joined[~fitted] = judged.fit.start, judged.check_fit.start
            starts = {self.fitted: joined}
        variant = judged.hypothesis.variant(self.bench.scene)
        for shooter, start in starts.items():
            if len(start) != len(shooter):
                continue
            self._warm[id(shooter)] = start
            if self.bench.contacts:
                self._free[id(shooter)] = start_derivatives(shooter, variant, start)
                if shooter is self.fitted:
                    self._own, self._told = None, (judged.hypothesis, start)

    def quick_loss(self, hypothesis: Hypothesis) -> float:
        """As `Judged.loss`, with starts alone fitted, and roughly.

        Raises:
          OrbiSimError: it cannot be simulated.
        """
        fits = {s: self.score(hypothesis, s, 2) for s in dict.fromkeys((self.fitted, self.check))}
        means = [_means(shooter, fit) for shooter, fit in fits.items()]
        return float(np.log1p(np.concatenate(means)).mean())

    def score(self, hypothesis: Hypothesis, shooter: Shooter, iterations: int = 4) -> Fit:
        """Residuals of fixed parameters, window starts fitted."""
        variant = hypothesis.variant(self.bench.scene)
        return gauss_newton(
            shooter,
            lambda _: variant,
            [],
            start=self._warm.get(id(shooter)),
            hints=self._hints(shooter),
            iterations=2 * iterations if is_structural(hypothesis) else iterations,
            robust=self.robust,
        )

    def _hints(
        self, shooter: Shooter, slopes: Mapping[int, Floats] | None = None, quick: bool = False
    ) -> Hints:
        free = self._free.get(id(shooter))
        lenient = _LENIENT if self.heavy else 0.0
        exact, rough = free is None, self.bench.contacts
        return Hints(free, slopes or {}, exact=exact, rough=rough, quick=quick, lenient=lenient)

    def _fitted(self, hypothesis: Hypothesis, iterations: int) -> tuple[Hypothesis, Fit]:
        declared = self.bench.scene
        fit = self._fit(hypothesis, iterations)
        fitted = hypothesis.at(declared, fit.values)
        weak = self._undetermined(fitted, fit)
        if weak:
            fitted = self._reset(hypothesis, fitted, weak)
            fit = self._fit(fitted, iterations)
            fitted = fitted.at(declared, fit.values)
        return fitted, fit

    def _fit(self, hypothesis: Hypothesis, iterations: int, quick: bool = False) -> Fit:
        declared = self.bench.scene
        first = len(hypothesis.free(declared))
        slopes = {
            first + f: self._slopes[one]
            for f, (one, _) in enumerate(hypothesis.factors)
            if one in self._slopes
        }
        own = self._own_slopes() if quick else None
        if own is not None:
            known = {one.name: own.slopes[..., k] for k, one in enumerate(own.unknowns)}
            names = [one.name for one in hypothesis.unknowns(declared)]
            slopes |= {k: known[name] for k, name in enumerate(names) if name in known}
        return gauss_newton(
            self.fitted,
            lambda values: hypothesis.at(declared, values).variant(declared),
            hypothesis.unknowns(declared),
            start=self._warm.get(id(self.fitted)),
            hints=self._hints(self.fitted, slopes, quick),
            iterations=iterations + 3 if is_structural(hypothesis) else iterations,
            robust=self.robust,
        )

    def _undetermined(self, fitted: Hypothesis, fit: Fit) -> list[tuple[int, str]]:
        """Parameters of effects that hardly change the data, compared with the others, or have run
        off to a bound that only says how far numbers go."""
        free = fitted.free(self.bench.scene)
        information = np.diag(fit.information.sum(axis=0))[: len(free)]
        values, unknowns = fit.values[: len(free)], fitted.unknowns(self.bench.scene)
        inside = [u.low < v < u.high for u, v in zip(unknowns, values, strict=False)]
        at_end = ~np.array(inside, bool)
        size = np.maximum(np.where(at_end, 0.0, np.abs(values)), 1e-3)
        change = np.sqrt(np.maximum(information, 0.0)) * size
        weak = change < max(_WEAK * change.max(initial=0.0), 1e-3)
        weak |= np.array([u.ran_off(v) for u, v in zip(unknowns, values, strict=False)], bool)
        weak &= np.array([not self._stepwise(fitted, i, name) for i, name in free], bool)
        if weak.all():
            return []
        return [name for name, w in zip(free, weak, strict=True) if w]

    def _reset(
        self, before: Hypothesis, fitted: Hypothesis, weak: Sequence[tuple[int, str]]
    ) -> Hypothesis:
        """The fitted hypothesis with undetermined parameters as they were, and held."""
        declared = self.bench.scene
        names = [*fitted.free(declared), *(None for _ in fitted.factors)]
        old, new = before.values(declared), fitted.values(declared)
        values = np.array([o if n in weak else v for n, o, v in zip(names, old, new, strict=True)])
        held = fitted.at(declared, values)
        return dataclasses.replace(held, frozen=held.frozen | set(weak))

    @staticmethod
    def _stepwise(hypothesis: Hypothesis, number: int, name: str) -> bool:
        effect = hypothesis.effects[number]
        return find(effect.effect).stepwise(effect, name)

    def _polish(self, hypothesis: Hypothesis, fit: Fit) -> tuple[Hypothesis, Fit]:
        """Searches parameters that act in steps (delays) on their grid, or on ever finer ones."""
        declared = self.bench.scene
        for index, (number, name) in enumerate(hypothesis.free(declared)):
            for grid in self._grids(hypothesis, number, name, float(fit.values[index])):
                here = round(fit.values[index] / grid)
                tried: dict[int, tuple[Hypothesis, Fit]] = {}
                here = self._descend(hypothesis, fit, (number, name), index, grid, here, tried)
                if here not in tried or not tried[here][1].square < fit.square:
                    continue
                held, other = tried[here]
                held = held.at(declared, other.values)
                hypothesis = dataclasses.replace(held, frozen=held.frozen - {(number, name)})
                values = hypothesis.values(declared)
                fit = dataclasses.replace(other, values=values, **_padded(other, index))
        return hypothesis, fit

    def _grids(self, hypothesis: Hypothesis, number: int, name: str, value: float) -> list[float]:
        """Steps of the grids on which a parameter is searched; none where it acts smoothly."""
        model = self.bench.scene.model
        grid = find(hypothesis.effects[number].effect).resolution(model, name)
        if grid:
            return [grid]
        if value and self._stepwise(hypothesis, number, name):
            return [share * abs(value) for share in _FINER]
        return []

    def _descend(
        self,
        hypothesis: Hypothesis,
        fit: Fit,
        which: tuple[int, str],
        index: int,
        grid: float,
        here: int,
        tried: dict[int, tuple[Hypothesis, Fit]],
    ) -> int:
        """Goes downhill on the grid from `here`."""

        def square(k: int) -> float:
            if k < 0:
                return np.inf
            if k not in tried:
                values = fit.values.copy()
                values[index] = k * grid
                trial = hypothesis.at(self.bench.scene, values)
                held = dataclasses.replace(trial, frozen=trial.frozen | {which})
                tried[k] = (held, self._fit(held, 2))
            return tried[k][1].square

        for _ in range(_GRID_STEPS_IN_CONTACT if self.bench.contacts else _GRID_STEPS):
            best = min((here - 1, here, here + 1), key=square)
            if best == here:
                break
            here = best
        return here


def is_structural(hypothesis: Hypothesis) -> bool:
    """Whether joints are added, whose state at a window's start nothing reads."""
    kinds = [find(e.effect) for e in hypothesis.effects]
    return any(kind.structural and kind.kind == "joint" for kind in kinds)


def _means(shooter: Shooter, fit: Fit) -> Floats:
    """Mean squared weighted residual of each window, its start's numbers counted."""
    return np.asarray(fit.per_window / np.maximum(shooter.data - 2 * shooter.nv, 1))


_IMPACTS = 4.0
"""Huber threshold where there are contacts: some impacts no fit of the start reproduces."""
_REACHED = 1.05
"""Residual over noise below which a fit is not made better."""
_GRID_STEPS = 12
_FINER = (0.12, 0.03, 0.008)
"""Grids for what acts in steps, of its value."""
_GRID_STEPS_IN_CONTACT = 2
_LENIENT = 4.0
_TRIMMED = 0.15
_MANY = 24
"""Windows of which every other one does for a glance."""


def _padded(fit: Fit, index: int) -> dict[str, Any]:
    """Information with a row for a parameter that was held."""
    return {
        "covariance": np.insert(np.insert(fit.covariance, index, 0, 0), index, 0, 1),
        "information": np.insert(np.insert(fit.information, index, 0, 1), index, 0, 2),
        "score": np.insert(fit.score, index, 0, 1),
    }


def thinned(keep: Bools, most: int | None) -> Bools:
    """At most so many of the chosen windows, spread evenly."""
    chosen = np.flatnonzero(keep)
    if most is None or len(chosen) <= most:
        return keep
    chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, most).round().astype(int))]
    kept = np.zeros_like(keep)
    kept[chosen] = True
    return kept
