"""Measurement noise, told apart from the motion by the model.

A sampled signal with fast content looks noisy to any differentiator. Along the linear system of
`orbisim.motion.linear` the motion is predictable but for the missing force; with a missing force
of arbitrary slow course in every joint, what is left over is the noise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import scipy.linalg

from orbisim.motion.linear import Intervals
from orbisim.motion.samples import Samples
from orbisim.shooting.impacts import near_jump
from orbisim.shooting.windows import Windows, cut_windows, evenly, hats_at, start_size

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

_KNOT = 4
"""Samples between knots of the missing force: what changes faster is taken for noise."""
_ROUNDS = 3
"""Fits, each weighted by the noise that the one before has found."""
_MAX_WINDOWS = 24
"""Windows that are looked at, spread evenly: they give the noise to some 5 %."""
_BRACE = 1e-10
"""Ridge that lets columns without any effect be factorized."""


def estimate_noise(
    samples: Sequence[Samples],
    intervals: Intervals,
    windows: Windows,
    known: Sequence[Floats] | None = None,
) -> tuple[Floats, Floats]:
    """Standard deviations of measured positions and velocities, each [nv]; NaN where not measured.

    Within each window, the start and a piecewise linear force (a knot every few samples) in
    every degree of freedom are fitted; the noise of each signal is what remains, degrees of freedom
    counted. Signals are weighted by their noise, which takes a few rounds.

    Args:
      known: for each recording what measurement effects add to it, [T, 2 nv].
    """
    nv = intervals.B.shape[2]
    one = samples[0]
    stretches = stretches_of(samples, intervals, windows, known)
    if stretches is None:
        return one.q_noise, one.v_noise
    found = np.full(2 * nv, np.nan)
    found[stretches.measured] = noise_left(stretches)[0]
    return found[:nv], found[nv:]


@dataclasses.dataclass(frozen=True, eq=False)
class Stretches:
    """What a motion and its noise have to do with each other, over stretches of recordings.

    Attributes:
      measured: [ny] columns of positions and velocities that are measured.
      design: [W, K, ny, P] responses to starts and forces. target: [W, K, ny] deviations.
      seen: [W, K, ny] whether these are there. guess: [ny] standard deviations to begin with.
    """

    measured: Ints
    design: Floats
    target: Floats
    seen: Bools
    guess: Floats


@dataclasses.dataclass(frozen=True, eq=False)
class Left:
    """What a weighted fit leaves of each stretch.

    Attributes:
      square: [W] sum of squares. freedom: [W] data less what was fitted to them.
      inner: [W] logarithm of the determinant of the normal matrix.
    """

    square: Floats
    freedom: Floats
    inner: Floats


def stretches_of(
    samples: Sequence[Samples],
    intervals: Intervals,
    windows: Windows,
    known: Sequence[Floats] | None = None,
    stiff: bool = False,
) -> Stretches | None:
    """Some windows, spread evenly; None where there are none, or nothing is measured.

    Args:
      known: as of `estimate_noise`.
      stiff: whether a force has one slope over a window, instead of a knot every few samples.
    """
    guess = np.concatenate([samples[0].q_noise, samples[0].v_noise])
    measured = np.flatnonzero(np.isfinite(guess))
    if not len(windows) or not len(measured):
        return None
    some = windows.some(evenly(np.ones(len(windows), bool), _MAX_WINDOWS))
    knots = 2 if stiff else max(2, windows.length // _KNOT + 1)
    flexible = _flexible(samples, intervals, some, measured, known, knots)
    return Stretches(measured, *flexible, np.maximum(guess[measured], 1e-12))


def noise_left(stretches: Stretches) -> tuple[Floats, Left]:
    """[ny]: noise of each signal, degrees of freedom counted; and what the last fit leaves."""
    sigma, left = stretches.guess, None
    for _ in range(_ROUNDS):
        sigma, left = _round(stretches, sigma)
    assert left is not None
    return sigma, left


def between_impacts(samples: Sequence[Samples], intervals: Intervals, windows: Windows) -> Windows:
    """Windows between impacts, for `estimate_noise` where bodies touch; `windows` where there are
    none.

    A difference across the moment at which bodies begin to touch, or to slip, is that of two
    motions over its step, and has no bound; chained, a few of them make anything of the noise.
    Next to an impact the smoothed motion is none of the scene's.
    """
    one = samples[0]
    step = float(np.median(np.concatenate([np.diff(each.time) for each in samples])))
    size = start_size((one.q_noise, one.v_noise), step)
    growth = np.sqrt(((intervals.A * size / size[:, None]) ** 2).sum(axis=2)).max(axis=1)
    near = [near_jump(each) for each in samples]
    jump = [near[i][r] for i, r in zip(intervals.recording, intervals.row, strict=True)]
    kept = np.flatnonzero((growth < _GROWTH) & intervals.usable & ~np.array(jump, bool))
    length = min(windows.length, _BETWEEN)
    found = cut_windows(intervals.recording[kept], intervals.row[kept], length)
    if len(found) < _FEW:
        return windows
    return Windows(kept[found.first], length, found.recording)


_GROWTH = 10.0
"""Growth of an error over one sampling interval, in units of the noise, that is no motion's."""
_BETWEEN = 4 * _KNOT
"""Intervals of a window between impacts: twice as many data as are fitted."""
_FEW = 4
"""Windows of which a median says something."""


def _flexible(
    samples: Sequence[Samples],
    intervals: Intervals,
    windows: Windows,
    measured: Ints,
    known: Sequence[Floats] | None,
    knots: int,
) -> tuple[Floats, Floats, Bools]:
    """Responses [W, K + 1, ny, P] to start and force knots, deviations and which are there."""
    n2, nv, k = intervals.A.shape[1], intervals.B.shape[2], windows.length
    hats = hats_at(np.linspace(0, k - 1, knots), k)
    width = n2 + nv * knots
    x = np.zeros((len(windows), n2, width + 1))
    x[:, :, :n2] = np.eye(n2)
    design = np.zeros((len(windows), k + 1, len(measured), width))
    target = np.zeros((len(windows), k + 1, len(measured)))
    both = [np.concatenate([s.dq, s.dv], axis=1) for s in samples]
    if known is not None:
        both = [seen - added for seen, added in zip(both, known, strict=True)]
    for step in range(k + 1):
        at = windows.first + min(step, k - 1)
        rows = [
            both[i][r + (step == k)][measured]
            for i, r in zip(intervals.recording[at], intervals.row[at], strict=True)
        ]
        design[:, step] = x[:, measured, :-1]
        target[:, step] = np.array(rows) - x[:, measured, -1]
        if step < k:
            x = np.einsum("wij,wjc->wic", intervals.A[at], x)
            push = np.einsum("wij,h->wijh", intervals.B[at], hats[step])
            x[:, :, n2:-1] += push.reshape(len(at), n2, -1)
            x[:, :, -1] -= intervals.defect[at]
    return design, target, np.isfinite(target)


def _round(stretches: Stretches, sigma: Floats) -> tuple[Floats, Left]:
    """Noise of each signal from the residuals of one weighted fit, and what that leaves."""
    windows, count = len(stretches.design), len(sigma)
    squares, freedom = np.zeros((windows, count)), np.zeros((windows, count))
    inner = np.zeros(windows)
    for w in range(windows):
        seen = stretches.seen[w]
        weight = seen / sigma
        matrix = (stretches.design[w] * weight[..., None]).reshape(-1, stretches.design.shape[3])
        values = (np.where(seen, stretches.target[w], 0.0) * weight).ravel()
        scale = np.linalg.norm(matrix, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        matrix = matrix / scale
        gram = matrix.T @ matrix + _BRACE * np.eye(matrix.shape[1])
        upper = np.linalg.cholesky(gram).T
        u = scipy.linalg.solve_triangular(upper, matrix.T, trans="T", check_finite=False).T
        left = (values - u @ (u.T @ values)).reshape(seen.shape)
        leverage = (u**2).sum(axis=1).reshape(seen.shape)
        squares[w] = (left**2).sum(axis=0)
        freedom[w] = (seen * (1 - leverage)).sum(axis=0)
        inner[w] = 2 * np.log(np.diag(upper) * scale).sum()
    found = np.maximum(sigma * np.sqrt(_typical(squares, freedom)), 1e-12)
    return found, Left(squares.sum(axis=1), freedom.sum(axis=1), inner)


def _typical(squares: Floats, freedom: Floats) -> Floats:
    """Variance of each signal: the median over windows, so that impacts do not count.

    The median of a chi-square with k degrees of freedom is about k (1 - 2 / (9 k))^3.
    """
    found = np.ones(squares.shape[1])
    for c in range(len(found)):
        good = freedom[:, c] > 1.0
        if good.any():
            k = freedom[good, c]
            found[c] = np.median(squares[good, c] / (k * (1 - 2 / (9 * k)) ** 3))
    return found
