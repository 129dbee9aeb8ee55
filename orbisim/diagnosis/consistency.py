"""Whether an effect is the same everywhere: what a wrong name gives away.

A true effect has one set of parameters, whatever the motion. A wrong one that stands in for
something else needs other values in slow motion than in fast, at one posture than at another, early
than late. Each window's share of the fit says which values it would prefer.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.bench import Bench
from orbisim.diagnosis.refine import Judged, thinned
from orbisim.effects import find

Floats = npt.NDArray[np.float64]

_TOLERANCE = 0.35
_SIGMAS = 4.0
_FEWEST = 8


def inconsistency(bench: Bench, judged: Judged) -> str | None:
    """What the last effect's first parameter depends on, if it does; None if it is consistent."""
    hypothesis, fit = judged.hypothesis, judged.fit
    windows = len(fit.per_window)
    index = _first_parameter(bench, judged)
    if index is None or windows < 2 * _FEWEST:
        return None
    value = _size(bench, judged, index)
    chosen = np.flatnonzero(thinned(bench.fit, windows))
    if len(chosen) != windows:
        return None
    for name, measure in _regimes(bench, chosen).items():
        halves = [measure <= np.median(measure), measure > np.median(measure)]
        if min(h.sum() for h in halves) < _FEWEST or np.ptp(measure) <= 0:
            continue
        (low, low_std), (high, high_std) = (_prefers(judged, index, h) for h in halves)
        gap, sure = abs(high - low), float(np.hypot(low_std, high_std))
        if gap > _TOLERANCE * value and gap > _SIGMAS * sure:
            effect = hypothesis.effects[-1]
            label = find(effect.effect).parameters(bench.scene.model, effect.target)[0].name
            return (
                f"its {label} would be {value + low:.3g} at low and {value + high:.3g} at high "
                f"{name}: something else is at work"
            )
    return None


def _first_parameter(bench: Bench, judged: Judged) -> int | None:
    """Number among the unknowns of the last effect's first free parameter."""
    last = len(judged.hypothesis.effects) - 1
    for index, (number, _) in enumerate(judged.hypothesis.free(bench.scene)):
        if number == last:
            return index
    return None


def _size(bench: Bench, judged: Judged, index: int) -> float:
    """Size of the parameter's departure from what the scene declares."""
    effect = judged.hypothesis.effects[-1]
    neutral = 1.0 if effect.effect in ("torque_gain", "sensor_scale", "clock_skew") else 0.0
    return abs(float(judged.fit.values[index]) - neutral)


def _prefers(judged: Judged, index: int, half: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Shift of the parameter that some windows prefer, and its standard error over windows."""
    information = judged.fit.information[half]
    score = judged.fit.score[half]
    gram = information.sum(axis=0)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-8) / np.outer(scale, scale)
    shift = inverse @ score.sum(axis=0)
    left = score - np.einsum("wpq,q->wp", information, shift)
    covariance = inverse @ (left.T @ left) @ inverse
    return float(shift[index]), float(np.sqrt(max(covariance[index, index], 0.0)))


def _regimes(bench: Bench, chosen: npt.NDArray[np.int64]) -> dict[str, Floats]:
    """Measures of each chosen window along which an effect should not change."""
    windows, intervals = bench.windows, bench.intervals
    speed, place, reach, when = [], [], [], []
    for w in chosen:
        first = windows.first[w]
        one = bench.samples[windows.recording[w]]
        rows = slice(int(intervals.row[first]), int(intervals.row[first]) + windows.length + 1)
        nv = one.absolute.shape[1] // 2
        q = one.absolute[rows, :nv]
        speed.append(float(np.sqrt(np.mean(one.qvel[rows] ** 2))))
        place.append(float(q.mean(axis=0).sum()))
        reach.append(float(np.sqrt(np.mean(q**2))))
        when.append(float(one.time[rows.start]))
    found = {"speed": speed, "position": place, "distance from zero": reach, "time": when}
    return {name: np.array(values) for name, values in found.items()}
