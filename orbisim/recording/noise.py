"""How noisy a sampled signal is, from the signal alone.

A contrast of order m is the combination of m + 1 neighbouring samples that vanishes on every
polynomial of degree below m, with unit norm; for uniform sampling it is the m-th difference divided
by sqrt(binomial(2 m, m)). On white noise every contrast has the noise's standard deviation; on a
smooth signal contrasts shrink quickly with m. The estimate is the scale of the contrasts at the
first order from which on it no longer falls (difference-based variance estimation: Gasser, Sroka
and Jennen-Steinmetz, Biometrika 73, 1986; Hall, Kay and Titterington, Biometrika 77, 1990).

The scale is a root mean square without outliers, so that a few impacts do not count as noise. A
signal whose values lie on a lattice of step d has at least the noise of rounding, d / sqrt(12)
(Widrow and Kollar, Quantization Noise, 2008). Noise with a spectrum of its own (filtered logs) is
seen only as far as it is white.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

_ORDERS = range(2, 10)
_CONVERGED = 0.9
"""An order of differences that leaves more than this share of the one before removes no motion."""
_STRETCHES, _STRETCH = 32, 4096
"""Pieces of a long signal that are looked at, and their samples."""
_AGAIN = 0.01
"""Share of the levels that are read more than once, from which on they are those of a lattice. Of
real numbers none is but by chance (of a thousand in single precision some 0.03); at rest one is."""
_EXACT = 1e-6
"""Of a step, by which multiples may be off where hardly any level is read again: what rounds is off
by the rounding of stored numbers, a uniform motion by its noise."""
_VARIOUS = 0.1
"""Share of the differences that are more than one step there: of a uniform motion without noise
only those across missing samples are."""
_CLIP = 4.0
"""Scales beyond which a difference is an event, not noise."""


def noise_std(time: npt.ArrayLike, values: npt.ArrayLike) -> Floats:
    """Standard deviation of the measurement noise of each channel.

    Args:
      time: [T], s, increasing, need not be uniform.
      values: [T] or [T, C]; NaN marks a missing sample.

    Returns:
      [C] (or a scalar array); NaN for channels with fewer than five samples.
    """
    t, y = np.asarray(time, np.float64), np.asarray(values, np.float64)
    columns = y.reshape(len(t), -1)
    found = [_channel(t, columns[:, c]) for c in range(columns.shape[1])]
    return np.array(found).reshape(y.shape[1:])


def roughness(time: npt.ArrayLike, values: npt.ArrayLike) -> Floats:
    """Root mean square of the third-order contrasts of each channel (noise and jerk together).

    Args:
      time: [T], s. values: [T, C]; NaN marks a missing sample.

    Returns:
      [C]; 0 for channels with fewer than four samples.
    """
    t, y = np.asarray(time, np.float64), np.asarray(values, np.float64)
    found = np.zeros(y.shape[1])
    for c in range(y.shape[1]):
        seen = np.isfinite(y[:, c])
        if seen.sum() >= 4:
            parts = [_contrasts(*part, 3) for part in _stretches(t[seen], y[seen, c])]
            found[c] = np.sqrt(np.mean(np.concatenate(parts) ** 2))
    return found


def lattice_step(values: npt.ArrayLike) -> float:
    """The step d of a signal whose values are whole multiples of d apart; 0 for any other.

    Samples of a uniform motion are equally far apart as well, to within the noise. On a lattice
    some values are read again, or differ by various multiples that are whole to rounding.
    """
    readings = _thinned(np.asarray(values, np.float64).ravel())
    levels, times = np.unique(readings, return_counts=True)
    if len(levels) < 3:
        return float(levels[-1] - levels[0]) if len(levels) == 2 else 0.0
    single = levels.astype(np.float32)
    stored = single if (single == levels).all() else levels  # float32 has a lattice of its own
    resolution = 4.0 * float(np.spacing(np.abs(stored).max()))
    gaps = np.diff(levels)
    gaps = gaps[gaps > resolution]
    if not len(gaps):
        return 0.0
    low = gaps[gaps < 1.5 * gaps.min()]
    step = float(np.median(low))
    tolerance = 0.02 + resolution / step
    if np.count_nonzero(times > 1) < max(2.0, _AGAIN * len(levels)):
        tolerance = _EXACT + resolution / step
        if (gaps > 1.5 * step).mean() < _VARIOUS:
            return 0.0
    whole = np.abs(gaps / step - np.round(gaps / step)) < tolerance
    return step if tolerance < 0.2 and whole.mean() > 0.95 else 0.0


def _channel(time: Floats, values: Floats) -> float:
    seen = np.isfinite(values)
    t, y = time[seen], values[seen]
    if len(t) < 5:
        return float("nan")
    rounding = lattice_step(y) / np.sqrt(12.0)
    return float(max(_contrast_scale(t, y), rounding))


def _contrast_scale(time: Floats, values: Floats) -> float:
    """Scale of the contrasts at the first order from which on it no longer falls."""
    stretches = _stretches(time, values)
    scale = np.inf
    for order in _ORDERS:
        parts = [_contrasts(t, y, order) for t, y in stretches if len(t) >= 2 * order]
        if not parts:
            break
        previous, scale = scale, _clipped_rms(np.concatenate(parts))
        if scale > _CONVERGED * previous:
            return min(scale, previous)
    return float(scale)


def _contrasts(time: Floats, values: Floats, order: int) -> Floats:
    """Contrasts [T - order] of unit norm; weights are those of divided differences."""
    count = len(time) - order
    nodes = np.stack([time[i : i + count] for i in range(order + 1)])
    nodes = (nodes - nodes[0]) / (nodes[-1] - nodes[0])
    gaps = nodes[:, None] - nodes[None]
    gaps[np.arange(order + 1), np.arange(order + 1)] = 1.0
    weights = 1.0 / gaps.prod(axis=1)
    weights /= np.linalg.norm(weights, axis=0)
    window = np.stack([values[i : i + count] for i in range(order + 1)])
    return np.asarray((weights * (window - window[0])).sum(axis=0))


def _clipped_rms(values: Floats) -> float:
    """Root mean square without what is beyond four times itself."""
    size = np.abs(values)
    scale = float(np.quantile(size, 0.9)) / 1.645
    for _ in range(8):
        kept = size[size <= _CLIP * scale]
        previous, scale = scale, float(np.sqrt(np.mean(kept**2))) if len(kept) else 0.0
        if abs(scale - previous) <= 1e-3 * previous:
            break
    return scale


def _stretches(time: Floats, values: Floats) -> list[tuple[Floats, Floats]]:
    """The signal, or pieces spread evenly over a long one."""
    if len(time) <= _STRETCHES * _STRETCH:
        return [(time, values)]
    starts = np.linspace(0, len(time) - _STRETCH, _STRETCHES).astype(int)
    return [(time[s : s + _STRETCH], values[s : s + _STRETCH]) for s in starts]


def _thinned(values: Floats) -> Floats:
    finite = values[np.isfinite(values)]
    limit = _STRETCHES * _STRETCH
    return finite if len(finite) <= limit else finite[:: -(-len(finite) // limit)]
