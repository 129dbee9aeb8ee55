"""Whether an effect is the same everywhere: what a wrong name gives away.

A true effect has one set of parameters, whatever the motion. A wrong one that stands in for
something else needs other values in slow motion than in fast, at one posture than at another, early
than late. Each window's share of the fit says which values it would prefer.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbisim.effects import find
from orbisim.effects.base import index_of, is_scalar_joint
from orbisim.shooting.bench import Bench
from orbisim.shooting.judge import Judged
from orbisim.shooting.windows import evenly

Floats = npt.NDArray[np.float64]

_SIGMAS = 3.0
"""Standard deviations from chance: a handful of measures is looked at for each effect."""
_FEWEST = 8
"""Windows that a half needs for a covariance over windows."""
TOLERANCE = 0.35
"""Share of its size by which an effect may be another in slow and fast motion and so on."""


def inconsistency(
    bench: Bench, judged: Judged, number: int, tolerance: float = TOLERANCE
) -> str | None:
    """What the parameters of an effect depend on, if they do; None if they are the same everywhere.

    The difference between what the windows of two regimes prefer is weighed by what it changes in
    the data, against what the whole effect changes.

    Args:
      number: of the effect in the hypothesis.
      tolerance: share of the effect's size by which it may differ.
    """
    fit = judged.fit
    windows = len(fit.per_window)
    free = judged.hypothesis.free(bench.scene)
    own, index = len(free), [k for k, (i, _) in enumerate(free) if i == number]
    if not index or windows < 2 * _FEWEST:
        return None
    chosen = np.flatnonzero(evenly(bench.fit, windows))
    if len(chosen) != windows:
        return None
    effect = judged.hypothesis.effects[number]
    neutral = find(effect.effect).neutral(bench.scene.model, effect.target)
    value = fit.values[index] - np.array([neutral.get(free[k][1], 0.0) for k in index])
    weight = fit.information.sum(axis=0)[np.ix_(index, index)]
    whole = float(np.sqrt(max(value @ weight @ value, 1e-300)))
    for name, measure in _regimes(bench, chosen, _dof(bench, judged, number)).items():
        halves = [measure <= np.median(measure), measure > np.median(measure)]
        if min(h.sum() for h in halves) < _FEWEST or np.ptp(measure) <= 0:
            continue
        (low, low_var), (high, high_var) = (_prefers(judged, own, index, h) for h in halves)
        gap = high - low
        change = float(np.sqrt(max(gap @ weight @ gap, 0.0)))
        chance = float(np.sqrt(max(np.trace(weight @ (low_var + high_var)), 0.0)))
        if change > tolerance * whole and change > _SIGMAS * chance:
            return (
                f"it would have to be {100 * change / whole:.0f} % different at low and at high "
                f"{name}: something else is at work"
            )
    return None


def _prefers(
    judged: Judged, own: int, index: list[int], half: npt.NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """Shift of the parameters that some windows prefer, and its covariance over windows.

    Args:
      own: how many parameters the effects have. Retuned declared parameters come after them and
        stay: a mass that is another one early and late would make up for anything.
    """
    information = judged.fit.information[half][:, :own, :own]
    score = judged.fit.score[half][:, :own]
    gram = information.sum(axis=0)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-8) / np.outer(scale, scale)
    shift = inverse @ score.sum(axis=0)
    left = score - np.einsum("wpq,q->wp", information, shift)
    covariance = inverse @ (left.T @ left) @ inverse
    return shift[index], covariance[np.ix_(index, index)]


def _dof(bench: Bench, judged: Judged, number: int) -> int | None:
    """The degree of freedom of an effect at a hinge or a slide; None for other effects."""
    effect, model = judged.hypothesis.effects[number], bench.scene.model
    if find(effect.effect).kind != "joint" or not is_scalar_joint(model, effect.target):
        return None
    return int(model.jnt_dofadr[index_of(model, "joint", effect.target)])


def _regimes(bench: Bench, chosen: npt.NDArray[np.int64], dof: int | None) -> dict[str, Floats]:
    """Measures of each chosen window along which an effect should not change.

    Args:
      dof: degree of freedom of the joint that it acts at; None if at none.
    """
    windows, intervals = bench.windows, bench.intervals
    found: dict[str, list[float]] = {}
    for w in chosen:
        first = windows.first[w]
        one = bench.samples[windows.recording[w]]
        rows = slice(int(intervals.row[first]), int(intervals.row[first]) + windows.length + 1)
        nv = one.absolute.shape[1] // 2
        q, v = one.absolute[rows, :nv], one.qvel[rows]
        measures = {
            "speed": np.sqrt(np.mean(v**2)),
            "position": q.mean(axis=0).sum(),
            "distance from zero": np.sqrt(np.mean(q**2)),
            "time": one.time[rows.start],
        }
        if dof is not None and nv > 1:
            measures["speed of its joint"] = np.sqrt(np.mean(v[:, dof] ** 2))
            measures["position of its joint"] = q[:, dof].mean()
        for name, value in measures.items():
            found.setdefault(name, []).append(float(value))
    return {name: np.array(values) for name, values in found.items()}
