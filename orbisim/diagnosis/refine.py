"""Fits of whole hypotheses by simulation, and how they fare on windows they have not seen."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.bench import Bench, Hypothesis
from orbisim.diagnosis.shooting import Fit, Shooter, gauss_newton
from orbisim.effects import find
from orbisim.errors import OrbiSimError

Floats = npt.NDArray[np.float64]

_WEAK = 1e-7


@dataclasses.dataclass(frozen=True, eq=False)
class Judged:
    """A hypothesis, fitted and checked.

    Attributes:
      hypothesis: with fitted values. fit: on the windows it was fitted to.
      checked: [windows] mean squared weighted residual of each check window, starts fitted.
      ratio: residual over noise on the check windows.
    """

    hypothesis: Hypothesis
    fit: Fit
    checked: Floats
    ratio: float

    @property
    def size(self) -> int:
        """Number of fitted parameters."""
        return len(self.fit.values)


class Judge:
    """Fits and checks hypotheses on the same windows.

    Args:
      bench: the data. most: at most so many windows are fitted (spread evenly), for speed.
      robust: residuals beyond this many standard deviations count linearly; None for none.
    """

    def __init__(self, bench: Bench, most: int | None = None, robust: float | None = None) -> None:
        self.bench, self.robust = bench, robust
        self.fitted = bench.shooter(_thinned(bench.fit, most))
        check = bench.check if bench.check.any() else bench.fit
        self.check = bench.shooter(_thinned(check, None if most is None else max(8, most // 2)))
        self._starts: dict[int, Floats] = {}

    def judge(self, hypothesis: Hypothesis, iterations: int = 6) -> Judged | None:
        """Fits the hypothesis' free parameters; None if it cannot be simulated."""
        declared = self.bench.scene
        try:
            fit = self._fit(hypothesis, iterations)
            fitted = hypothesis.at(declared, fit.values)
            weak = _undetermined(fit)
            if weak.any() and not weak.all():
                names = [f for f, w in zip(fitted.free(declared), weak, strict=True) if w]
                fitted = hypothesis.at(declared, _kept(hypothesis, declared, fit, weak))
                fitted = dataclasses.replace(fitted, frozen=fitted.frozen | set(names))
                fit = self._fit(fitted, iterations)
                fitted = fitted.at(declared, fit.values)
            fitted, fit = self._polish(fitted, fit)
            checked = self.score(fitted, self.check)
        except (OrbiSimError, np.linalg.LinAlgError):
            return None
        data = self.check.seen.reshape(len(self.check), -1).sum(axis=1)
        free = np.maximum(data - 2 * self.check.nv, 1)
        mean = checked.per_window / free
        ratio = float(np.sqrt(checked.per_window.sum() / free.sum()))
        return Judged(fitted, fit, mean, ratio)

    def score(self, hypothesis: Hypothesis, shooter: Shooter) -> Fit:
        """Residuals of fixed parameters, window starts fitted."""
        scene = hypothesis.scene(self.bench.scene)
        return gauss_newton(shooter, lambda _: scene, [], iterations=5, robust=self.robust)

    def _fit(self, hypothesis: Hypothesis, iterations: int) -> Fit:
        declared = self.bench.scene
        return gauss_newton(
            self.fitted,
            lambda values: hypothesis.at(declared, values).scene(declared),
            hypothesis.unknowns(declared),
            iterations=iterations,
            robust=self.robust,
        )

    def _polish(self, hypothesis: Hypothesis, fit: Fit) -> tuple[Hypothesis, Fit]:
        """Searches parameters that act in steps (delays) on their grid."""
        declared = self.bench.scene
        for index, (number, name) in enumerate(hypothesis.free(declared)):
            effect = find(hypothesis.effects[number].effect)
            grid = effect.resolution(declared.model, name)
            if not grid:
                continue
            middle = round(fit.values[index] / grid)
            for k in range(middle - 3, middle + 4):
                if k < 0:
                    continue
                values = fit.values.copy()
                values[index] = k * grid
                trial = hypothesis.at(declared, values)
                held = dataclasses.replace(trial, frozen=trial.frozen | {(number, name)})
                other = self._fit(held, 3)
                if other.square < fit.square * (1 - 1e-9):
                    hypothesis = held.at(declared, other.values)
                    hypothesis = dataclasses.replace(
                        hypothesis, frozen=hypothesis.frozen - {(number, name)}
                    )
                    best = hypothesis.values(declared)
                    fit = dataclasses.replace(other, values=best, **_padded(other, index))
        return hypothesis, fit


def _padded(fit: Fit, index: int) -> dict[str, Floats]:
    """Information with a row for a parameter that was held."""
    return {
        "covariance": np.insert(np.insert(fit.covariance, index, 0, 0), index, 0, 1),
        "information": np.insert(np.insert(fit.information, index, 0, 1), index, 0, 2),
        "score": np.insert(fit.score, index, 0, 1),
    }


def _undetermined(fit: Fit) -> npt.NDArray[np.bool_]:
    """Parameters that hardly change the data, compared with the others."""
    strength = np.sqrt(np.maximum(np.diag(fit.information.sum(axis=0)), 0.0))
    size = np.maximum(np.abs(fit.values), 1e-3)
    change = strength * size
    return np.asarray(change < max(_WEAK * change.max(initial=0.0), 1e-3))


def _kept(
    hypothesis: Hypothesis, declared: object, fit: Fit, weak: npt.NDArray[np.bool_]
) -> Floats:
    before = hypothesis.values(declared)  # type: ignore[arg-type]
    return np.where(weak, before, fit.values)


def _thinned(keep: npt.NDArray[np.bool_], most: int | None) -> npt.NDArray[np.bool_]:
    chosen = np.flatnonzero(keep)
    if most is None or len(chosen) <= most:
        return keep
    chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, most).round().astype(int))]
    thinned = np.zeros_like(keep)
    thinned[chosen] = True
    return thinned
