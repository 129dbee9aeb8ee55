"""Linear regression of measured deviations on columns, window by window.

In each window the deviation at its start is free (its columns are projected out), and columns
respond through the linear system of `orbisim.motion.linear`. What is kept are inner products,
with every datum weighted by its noise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from orbisim.effects.screening import Column
from orbisim.motion.linear import Intervals
from orbisim.motion.samples import Samples
from orbisim.shooting.windows import Windows, chosen, whitening_of

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

_CHUNK_BYTES = 2e8
"""Memory that the columns of windows take at once."""


@dataclasses.dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations: gram x = moment, with the sum of squares that is left at x = 0.

    Attributes:
      gram: [C, C]. moment: [C]. square: sum of squared weighted data. count: number of data left
        after the starts of the windows were fitted.
    """

    gram: Floats
    moment: Floats
    square: float
    count: int

    def __add__(self, other: Normal) -> Normal:
        return Normal(
            self.gram + other.gram,
            self.moment + other.moment,
            self.square + other.square,
            self.count + other.count,
        )


def normal_equations(
    samples: Sequence[Samples],
    intervals: Intervals,
    windows: Windows,
    columns: Sequence[Column],
    noise: tuple[Floats, Floats],
    known: Sequence[Floats] | None = None,
) -> list[Normal]:
    """Normal equations of each window.

    Args:
      noise: standard deviations of positions and velocities, each [nv]; NaN where not measured.
      known: for each recording what measurement effects add to it, [T, 2 nv].
    """
    if not len(windows):
        return []
    inputs, signals = stacked(intervals, columns)
    data = WeightedData(samples, intervals, noise, known)
    return [normal_of(*one) for one in projected(intervals, windows, inputs, signals, data)]


def normal_of(design: Floats, target: Floats, count: int) -> Normal:
    """Normal equations of weighted columns [R, C] and data [R]."""
    return Normal(design.T @ design, design.T @ target, float(target @ target), count)


def stacked(intervals: Intervals, columns: Sequence[Column]) -> tuple[Floats, Floats | None]:
    """State inputs [N, 2 nv, C] and signals [2 N, 2 nv, C] of the columns."""
    count, n2, _ = intervals.B.shape
    inputs = np.zeros((count, n2, len(columns)))
    signals = None
    for c, column in enumerate(columns):
        if column.kind == "force":
            mean = 0.5 * (column.values[:count] + column.values[count:])
            inputs[:, :, c] = np.einsum("kij,kj->ki", intervals.B, np.nan_to_num(mean))
        elif column.kind == "state":
            inputs[:, :, c] = np.nan_to_num(column.values)
        else:
            if signals is None:
                signals = np.zeros((2 * count, n2, len(columns)))
            signals[:, :, c] = np.nan_to_num(column.values)
    return inputs, signals


def force_columns(force: Floats) -> list[Column]:
    """A force [N, nv] over intervals, of each degree of freedom by itself."""
    found: list[Column] = []
    for dof in range(force.shape[1]):
        values = np.zeros((2 * len(force), force.shape[1]))
        values[: len(force), dof] = values[len(force) :, dof] = force[:, dof]
        found.append(Column("force", values))
    return found


class WeightedData:
    """Measured deviations and their weights at the ends of the intervals."""

    def __init__(
        self,
        samples: Sequence[Samples],
        intervals: Intervals,
        noise: tuple[Floats, Floats],
        known: Sequence[Floats] | None,
    ) -> None:
        sigma = np.concatenate(noise)
        both = [np.concatenate([s.dq, s.dv], axis=1) for s in samples]
        if known is not None:
            both = [seen - added for seen, added in zip(both, known, strict=True)]
        pairs = list(zip(intervals.recording, intervals.row, strict=True))
        self.starts = np.array([both[i][r] for i, r in pairs])
        self.ends = np.array([both[i][r + 1] for i, r in pairs])
        self.measured = np.flatnonzero(np.isfinite(sigma))
        self.weight = 1.0 / sigma[self.measured]

    def rows(self, values: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
        """Weighted deviations [W, ny] (zero where missing) and which are there."""
        picked = values[:, self.measured]
        seen = np.isfinite(picked)
        return np.where(seen, picked, 0.0) * self.weight, seen


Extra = Callable[[int, Ints], Floats]
"""Inputs [W, 2 nv, E] that are no columns, from the number of the sample and the intervals [W]."""


def projected(
    intervals: Intervals,
    windows: Windows,
    inputs: Floats,
    signals: Floats | None,
    data: WeightedData,
    extra: Extra | None = None,
) -> list[Projected]:
    """Data and columns of each window, its free start projected out.

    Args:
      inputs, signals: as `stacked` gives them.
      extra: further inputs; their columns come first.
    """
    n2 = intervals.defect.shape[1]
    width = n2 + inputs.shape[2] + (0 if extra is None else extra(0, windows.first[:1]).shape[2])
    most = max(1, int(_CHUNK_BYTES / (8 * (windows.length + 1) * n2 * (width + 1))))
    found: list[Projected] = []
    for begin in range(0, len(windows), most):
        part = windows.some(np.arange(len(windows)) // most == begin // most)
        found += _part(intervals, part, inputs, signals, data, extra, width)
    return found


def _part(
    intervals: Intervals,
    windows: Windows,
    inputs: Floats,
    signals: Floats | None,
    data: WeightedData,
    extra: Extra | None,
    width: int,
) -> list[Projected]:
    """As `projected`, at once; `width` of start, extra inputs and columns."""
    count, n2 = intervals.defect.shape
    free = width - inputs.shape[2]
    w, ny = len(windows), len(data.measured)
    design = np.zeros((w, windows.length + 1, ny, width))
    target = np.zeros((w, windows.length + 1, ny))
    seen = np.zeros((w, windows.length + 1, ny), bool)
    x = np.zeros((w, n2, width + 1))
    x[:, :, :n2] = np.eye(n2)
    for k in range(windows.length + 1):
        inside, last = k < windows.reach(), windows.first + windows.reach() - 1
        at = np.minimum(windows.first + k, last)
        values = np.where(inside[:, None], data.starts[at], data.ends[at])
        deviation, seen[:, k] = data.rows(values)
        scaled = x[:, data.measured] * data.weight[:, None]
        target[:, k] = deviation - scaled[:, :, -1]
        design[:, k] = scaled[:, :, :-1]
        if signals is not None:
            rows = np.where(inside, at, count + at)
            design[:, k, :, free:] += signals[rows][:, data.measured] * data.weight[:, None]
        if k < windows.length:
            x = np.einsum("wij,wjc->wic", intervals.A[at], x)
            if extra is not None:
                x[:, :, n2:free] += extra(k, at)
            x[:, :, free:-1] += inputs[at]
            x[:, :, -1] -= intervals.defect[at]
    seen &= chosen(windows.predictable(), data.measured)
    design, target = design * seen[..., None], target * seen
    whitening = whitening_of(windows, data.measured, seen)
    if whitening is not None:
        design, target = whitening(design), whitening(target)
    flat, left = design.reshape(w, -1, width), target.reshape(w, -1)
    return [without_start(flat[i], left[i], n2, int(seen[i].sum())) for i in range(w)]


class Projected(NamedTuple):
    """A window without what its free start explains.

    Attributes:
      design: [R, C] weighted columns. target: [R] weighted data. rows: number of
        data, less those that fix the start.
    """

    design: Floats
    target: Floats
    rows: int


def without_start(design: Floats, target: Floats, free: int, count: int) -> Projected:
    """Removes what the first columns explain. What is chained through impacts may grow beyond what
    squares of numbers hold: such rows say nothing.

    Args:
      design: [R, free + C]. target: [R]. free: number of columns that fix the start.
      count: of data.
    """
    known = (np.abs(design) < _LARGEST).all(axis=1) & (np.abs(target) < _LARGEST)
    design, target = np.where(known[:, None], design, 0.0), np.where(known, target, 0.0)
    count -= int(np.count_nonzero(~known))
    basis, triangle = np.linalg.qr(design[:, :free])
    strength = np.abs(np.diag(triangle))
    basis = basis[:, strength > 1e-9 * max(strength.max(initial=0.0), 1e-300)]
    rest = design[:, free:] - basis @ (basis.T @ design[:, free:])
    return Projected(rest, target - basis @ (basis.T @ target), count - basis.shape[1])


_LARGEST = 1e30
"""Of weighted data and columns: products of such numbers with the forces of impacts are finite."""


def total(normals: Sequence[Normal]) -> Normal:
    """The sum of the windows' normal equations."""
    result = normals[0]
    for one in normals[1:]:
        result = result + one
    return result


def levelled(normals: Sequence[Normal]) -> list[Normal]:
    """Windows with those that leave much more than most weighed less, as Huber's loss would."""
    left = np.sqrt([max(one.square, 0.0) / max(one.count, 1) for one in normals])
    usual = float(np.median(left))
    if not usual > 0:
        return list(normals)
    weights = np.minimum(1.0, usual / np.maximum(left, 1e-300))
    return [
        Normal(w * one.gram, w * one.moment, w * one.square, one.count)
        for w, one in zip(weights, normals, strict=True)
    ]


def fit(
    normal: Normal, columns: Sequence[int], ridge: Floats | None = None
) -> tuple[Floats, float]:
    """Least-squares coefficients of some columns and the sum of squares that is left.

    A column of which nothing is left has a coefficient of zero.

    Args:
      ridge: [len(columns)] inverse prior variances.
    """
    index = list(columns)
    if not index:
        return np.zeros(0), normal.square
    gram, moment = normal.gram[np.ix_(index, index)], normal.moment[index]
    scaled, scale = scaled_gram(gram)
    if ridge is not None:
        scaled = scaled + np.diag(ridge / scale**2)
    scaled = scaled + 1e-12 * np.eye(len(index))
    x = np.linalg.lstsq(scaled, np.where(np.isfinite(moment), moment, 0.0) / scale, rcond=1e-11)[0]
    x = x / scale
    felt = x != 0.0  # what overflows has no coefficient
    gram, moment = gram[np.ix_(felt, felt)], moment[felt]
    left = normal.square - 2 * x[felt] @ moment + x[felt] @ gram @ x[felt]
    return x, float(max(left, 0.0))


def left_by_each(normal: Normal) -> Floats:
    """[C]: sum of squares that each column alone leaves, as `fit` has it."""
    strength = np.diag(normal.gram)
    felt = np.isfinite(strength) & np.isfinite(normal.moment) & (strength > _NOTHING)
    moment = np.where(felt, normal.moment, 0.0) / np.sqrt(np.where(felt, strength, 1.0))
    return np.asarray(np.maximum(normal.square - moment**2, 0.0))


def scaled_gram(gram: Floats) -> tuple[Floats, Floats]:
    """Gram matrices [..., P, P] of columns of unit length, and the lengths [..., P].

    A column of which hardly anything is left, or that overflows, has an infinite length: it says
    nothing, and has no coefficient.
    """
    strength = np.einsum("...ii->...i", gram)
    felt = np.isfinite(strength) & (strength > _NOTHING)
    scale = np.sqrt(np.where(felt, strength, np.inf))
    known = felt[..., :, None] & felt[..., None, :] & np.isfinite(gram)
    # one after the other: the product of two short lengths is 0
    return np.where(known, gram, 0.0) / scale[..., :, None] / scale[..., None, :], scale


_NOTHING = 1e-280
"""Square of a length whose products with others of its kind are no longer normal numbers."""


def with_ones(normal: Normal, columns: Sequence[int]) -> Normal:
    """Normal equations of what is left where some columns have a coefficient of one."""
    index = list(columns)
    if not index:
        return normal
    taken = normal.gram[:, index].sum(axis=1)
    square = normal.square - 2 * normal.moment[index].sum() + taken[index].sum()
    return Normal(normal.gram, normal.moment - taken, float(square), normal.count)


def profiled(normal: Normal, nuisance: Sequence[int], ridge: Floats) -> Normal:
    """Normal equations after some columns, with priors about zero, have been fitted away.

    Args:
      nuisance: the columns, which stay in place but no longer explain anything.
      ridge: [len(nuisance)] inverse prior variances.
    """
    index = list(nuisance)
    if not index:
        return normal
    scaled, scale = scaled_gram(normal.gram[np.ix_(index, index)] + np.diag(ridge))
    inverse = np.linalg.pinv(scaled, rcond=1e-11) / scale[:, None] / scale
    felt = np.isfinite(scale)  # what overflows explains nothing
    across = np.where(felt, normal.gram[:, index], 0.0)
    moment = np.where(felt, normal.moment[index], 0.0)
    return Normal(
        normal.gram - across @ inverse @ across.T,
        normal.moment - across @ inverse @ moment,
        max(float(normal.square - moment @ inverse @ moment), 0.0),
        normal.count,
    )
