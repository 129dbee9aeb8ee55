"""Filter and smoother of a moving point whose jerk is white noise, for many series at once.

The state of a series is (position p, velocity v, acceleration a). Over an interval h it moves by
F = [[1, h, h^2/2], [0, 1, h], [0, 0, 1]] and a disturbance of covariance level * G(h), where
G = [[h^5/20, h^4/8, h^3/6], [h^4/8, h^3/3, h^2/2], [h^3/6, h^2/2, h]]: the integrals of white jerk
(Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
section 6.2). Positions are measured with unit variance. The posterior mean is the quintic smoothing
spline of the measurements (Wahba, Spline Models for Observational Data, 1990).

Backward recursion: Bryson and Frazier's, which carries the adjoint state and its covariance and
inverts nothing (Bierman, Automatica 9, 1973). The standardised adjoint also tells in which interval
the series was disturbed more than the model has it, and which measurement does not belong (de Jong
and Penzer, Journal of the American Statistical Association 93, 1998).

Arrays have time first and the series last; symmetric matrices are six rows 00, 01, 02, 11, 12, 22.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

_WIDE = 100.0
"""How much wider the initial distribution is than what it was estimated from."""


@dataclasses.dataclass(frozen=True)
class Filtered:
    """Distribution of the state given the measurements so far.

    Attributes:
      mean: [T, 3, B]. cov: [T, 6, B]. Both after the measurement of their row.
      innovation: [T, B] measured minus predicted position; 0 where nothing was measured.
      precision: [T, B] inverse variance of the innovation; 0 where nothing was measured.
    """

    mean: Floats
    cov: Floats
    innovation: Floats
    precision: Floats

    def log_likelihood(self, scored: npt.NDArray[np.bool_]) -> Floats:
        """[B]: of the measurements at the rows `scored` [T, B], up to a constant."""
        used = scored & (self.precision > 0)
        precision = np.where(used, self.precision, 1.0)
        terms = np.log(precision) - np.where(used, self.innovation, 0.0) ** 2 * precision
        return np.asarray(0.5 * terms.sum(axis=0))


@dataclasses.dataclass(frozen=True)
class Posterior:
    """Distribution of the state given all measurements of a series.

    Attributes:
      mean: [T, 3, B]. variance: [T, 3, B].
      shock: [T - 1, B] evidence that velocity or acceleration jumped within an interval.
      outlier: [T, B] evidence that a measurement is off. Both are squares of standardised
        residuals: about chi-square with one degree of freedom if nothing happened.
    """

    mean: Floats
    variance: Floats
    shock: Floats
    outlier: Floats


def run_filter(step: Floats, measured: Floats, level: Floats, *, keep: bool = True) -> Filtered:
    """The forward recursion.

    Args:
      step: [T - 1, B] intervals. measured: [T, B], NaN where nothing was measured.
      level: [T - 1, B] intensity of the jerk in each interval.
      keep: whether to keep means and covariances; without them only the likelihood can be had.
    """
    count, series = measured.shape
    mean = np.empty((count if keep else 0, 3, series))
    cov = np.empty((count if keep else 0, 6, series))
    seen = np.isfinite(measured)
    target = np.where(seen, measured, 0.0)
    innovation, precision = np.zeros((count, series)), np.zeros((count, series))
    (p, v, a), (c00, c01, c02, c11, c12, c22) = _start(step, measured, level)
    for i in range(count):
        if i:
            h = step[i - 1]
            k, q = 0.5 * h * h, level[i - 1]
            p, v = p + h * v + k * a, v + h * a
            r2 = c02 + h * c12 + k * c22
            r1 = c01 + h * c11 + k * c12
            s12 = c12 + h * c22
            qh = q * h
            qk = qh * k
            c00 = c00 + h * (c01 + r1) + k * (c02 + r2) + qk * k * 0.2
            c01 = r1 + h * r2 + qk * h * 0.25
            c11 = c11 + h * (c12 + s12) + qk * (2.0 / 3.0)
            c02, c12, c22 = r2 + qk * (1.0 / 3.0), s12 + q * k, c22 + qh
        inverse = seen[i] / (c00 + 1.0)
        error = (target[i] - p) * seen[i]
        innovation[i], precision[i] = error, inverse
        g0, g1, g2 = c00 * inverse, c01 * inverse, c02 * inverse
        p, v, a = p + g0 * error, v + g1 * error, a + g2 * error
        left = np.where(seen[i], inverse, 1.0)
        c11, c12, c22 = c11 - g1 * c01, c12 - g1 * c02, c22 - g2 * c02
        c00, c01, c02 = c00 * left, c01 * left, c02 * left
        if keep:
            mean[i] = p, v, a
            cov[i] = c00, c01, c02, c11, c12, c22
    return Filtered(mean, cov, innovation, precision)


def run_smoother(step: Floats, filtered: Filtered) -> Posterior:
    """The backward recursion."""
    count, _, series = filtered.mean.shape
    mean, variance = np.empty_like(filtered.mean), np.empty_like(filtered.mean)
    shock, outlier = np.zeros((max(count - 1, 0), series)), np.zeros((count, series))
    zero = np.zeros(series)
    l0, l1, l2 = zero, zero, zero  # adjoint state
    m00, m01, m02, m11, m12, m22 = (zero,) * 6  # and its covariance
    for i in range(count - 1, -1, -1):
        x, (c00, c01, c02, c11, c12, c22) = filtered.mean[i], filtered.cov[i]
        for row, (u0, u1, u2) in enumerate(((c00, c01, c02), (c01, c11, c12), (c02, c12, c22))):
            mean[i, row] = x[row] - (u0 * l0 + u1 * l1 + u2 * l2)
            w0 = u0 * m00 + u1 * m01 + u2 * m02
            w1 = u0 * m01 + u1 * m11 + u2 * m12
            w2 = u0 * m02 + u1 * m12 + u2 * m22
            variance[i, row] = (c00, c11, c22)[row] - (u0 * w0 + u1 * w1 + u2 * w2)
        inverse = filtered.precision[i]
        seen = inverse > 0
        g0, g1, g2 = c00 * seen, c01 * seen, c02 * seen  # the gain, as measurements have variance 1
        residual = g0 * l0 + g1 * l1 + g2 * l2 + filtered.innovation[i] * inverse
        l0 = l0 - residual
        n0 = g0 * m00 + g1 * m01 + g2 * m02
        n1 = g0 * m01 + g1 * m11 + g2 * m12
        n2 = g0 * m02 + g1 * m12 + g2 * m22
        spread = g0 * n0 + g1 * n1 + g2 * n2 + inverse
        outlier[i] = _squared_ratio(residual, spread)
        m00 = m00 - 2.0 * n0 + spread
        m01, m02 = m01 - n1, m02 - n2
        if i:
            shock[i - 1] = np.maximum(_squared_ratio(l1, m11), _squared_ratio(l2, m22))
            h = step[i - 1]
            k = 0.5 * h * h
            l2, l1 = l2 + h * l1 + k * l0, l1 + h * l0
            t11, t12 = m11 + h * m01, m12 + h * m02
            t01 = m01 + h * m00
            t22 = m22 + h * m12 + k * m02
            t21 = m12 + h * m11 + k * m01
            t20 = m02 + h * m01 + k * m00
            m11, m12 = t11 + h * t01, t12 + h * t11 + k * t01
            m22, m01, m02 = t22 + h * t21 + k * t20, t01, t20
    return Posterior(mean, np.maximum(variance, 0.0), shock, outlier)


def _squared_ratio(value: Floats, variance: Floats) -> Floats:
    return np.asarray(value * value / np.maximum(variance, 1e-300))


def _start(
    step: Floats, measured: Floats, level: Floats
) -> tuple[tuple[Floats, ...], tuple[Floats, ...]]:
    """State and covariance at the first row: the parabola through three early samples.

    The samples are used again by the filter, so the covariance is taken `_WIDE` times that of the
    parabola: they count for one per cent too much, and nothing has to cancel a diffuse prior.
    """
    series = np.arange(measured.shape[1])
    time = np.concatenate([np.zeros((1, len(series))), np.cumsum(step, axis=0)])
    rows = _early_rows(time, np.isfinite(measured))
    t = np.stack([time[row, series] for row in rows])
    y = np.nan_to_num(np.stack([measured[row, series] for row in rows]))
    until = np.arange(len(level))[:, None] < np.maximum(rows[2], 1)
    intensity = np.where(until, level, 0.0).max(axis=0, initial=0.0)
    weights = _parabola(t)
    mean = np.einsum("abk,bk->ak", weights, y)
    cov = _WIDE * np.einsum("abk,cbk->ack", weights, weights)
    reach = np.maximum(t[2], 1.0)
    for order, power in enumerate((5, 3, 1)):
        cov[order, order] += _WIDE * intensity * reach**power
    few = ~np.isfinite(measured[rows[2], series]) | (rows[2] == rows[1])
    cov[2, 2] += np.where(few, _WIDE * (1.0 + mean[1] ** 2), 0.0)
    return tuple(mean), (cov[0, 0], cov[0, 1], cov[0, 2], cov[1, 1], cov[1, 2], cov[2, 2])


def _early_rows(time: Floats, seen: npt.NDArray[np.bool_]) -> list[npt.NDArray[np.int64]]:
    """The first sample and the next two at least half a unit apart; repeated where missing."""
    series = np.arange(seen.shape[1])
    rows = [seen.argmax(axis=0)]
    for _ in range(2):
        later = seen & (time >= time[rows[-1], series] + 0.5)
        rows.append(np.where(later.any(axis=0), later.argmax(axis=0), rows[-1]))
    return rows


def _parabola(t: Floats) -> Floats:
    """[3, 3, B]: position, velocity, acceleration at time 0 from values at the times t [3, B].

    A line where the third time repeats the second, a constant where all are the same.
    """
    weights = np.zeros((3, 3, t.shape[1]))
    one, two = t[1] == t[0], (t[2] == t[1]) & (t[1] != t[0])
    three = ~one & ~two
    weights[0, 0, one] = 1.0
    gap = np.where(two, t[1] - t[0], 1.0)
    for node, (at, other) in enumerate(((0, 1), (1, 0))):
        sign = 1.0 if at else -1.0
        weights[0, node, two] = (-sign * t[other] / gap)[two]
        weights[1, node, two] = (sign / gap)[two]
    for node in range(3):
        a, b = (t[k] for k in range(3) if k != node)
        scale = np.where(three, (t[node] - a) * (t[node] - b), 1.0)
        for order, value in enumerate((a * b, -(a + b), 2.0 * np.ones_like(a))):
            weights[order, node, three] = (value / scale)[three]
    return weights
