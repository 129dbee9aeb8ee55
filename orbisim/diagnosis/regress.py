"""Linear regression of measured deviations on columns, window by window.

In each window the deviation at its start is free (its columns are projected out), and columns
respond through the linear system of `orbisim.diagnosis.linear`. What is kept are inner products,
with every datum weighted by its noise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.linear import Intervals
from orbisim.diagnosis.samples import Samples
from orbisim.effects.screening import Column

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

_CHUNK_BYTES = 2e8


@dataclasses.dataclass(frozen=True, eq=False)
class Windows:
    """Consecutive usable intervals of one recording each.

    Attributes:
      first: [W] number of the first interval. length: number of intervals of every window.
      recording: [W]. horizon: [W, 2 nv] samples after the start at which each position and velocity
        can be predicted; all if None.
    """

    first: Ints
    length: int
    recording: Ints
    horizon: Ints | None = None

    def __len__(self) -> int:
        return len(self.first)

    def some(self, keep: npt.NDArray[np.bool_]) -> Windows:
        """The chosen windows."""
        horizon = None if self.horizon is None else self.horizon[keep]
        return Windows(self.first[keep], self.length, self.recording[keep], horizon)

    def reach(self) -> Ints:
        """[W]: number of intervals that can be predicted."""
        if self.horizon is None:
            return np.full(len(self), self.length)
        return np.minimum(self.horizon.max(axis=1), self.length)

    def fragile(self) -> npt.NDArray[np.bool_]:
        """[W]: windows that end early, as impacts make what follows uncertain."""
        if self.horizon is None:
            return np.zeros(len(self), bool)
        return np.asarray((self.horizon < self.length).any(axis=1))

    def predictable(self) -> npt.NDArray[np.bool_]:
        """[W, length + 1, 2 nv] or [W, length + 1, 1]: what lies within the horizon."""
        steps = np.arange(self.length + 1)[:, None]
        if self.horizon is None:
            return np.ones((len(self), self.length + 1, 1), bool)
        return np.asarray(steps <= self.horizon[:, None])


def cut_windows(
    recording: Ints, row: Ints, length: int, avoid: npt.NDArray[np.bool_] | None = None
) -> Windows:
    """Cuts runs of consecutive intervals into windows of the same length.

    A run that is no multiple of it gives a last window that overlaps the one before.

    Args:
      recording, row: [N] of the intervals. avoid: [N] where no window should start.
    """
    firsts: list[int] = []
    for start, stop in runs_of(recording, row):
        begin = start
        while begin + length <= stop:
            while avoid is not None and avoid[begin] and begin + length < stop:
                begin += 1
            firsts.append(begin)
            begin += length
        left = stop - begin
        if firsts and left > length // 2 and stop - length > firsts[-1]:
            firsts.append(stop - length)
    first = np.array(firsts, np.int64)
    return Windows(first, length, recording[first] if len(first) else first)


def runs_of(recording: Ints, row: Ints) -> Iterator[tuple[int, int]]:
    """Ranges of intervals that follow one another."""
    if not len(row):
        return
    joined = (np.diff(recording) == 0) & (np.diff(row) == 1)
    breaks = np.flatnonzero(~joined) + 1
    yield from zip([0, *breaks], [*breaks, len(row)], strict=True)


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
    nv = intervals.B.shape[2]
    inputs, signals = stacked(intervals, columns)
    data = WeightedData(samples, intervals, noise, known)
    width = 2 * nv + 1 + len(columns)
    chunk = max(1, int(_CHUNK_BYTES / (8 * (windows.length + 1) * 2 * nv * width)))
    result: list[Normal] = []
    for begin in range(0, len(windows), chunk):
        part = windows.some(np.arange(len(windows)) // chunk == begin // chunk)
        result += _chunk(intervals, part, inputs, signals, data)
    return result


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


def _chunk(
    intervals: Intervals,
    windows: Windows,
    inputs: Floats,
    signals: Floats | None,
    data: WeightedData,
) -> list[Normal]:
    count, n2 = intervals.defect.shape
    c = inputs.shape[2]
    w, ny = len(windows), len(data.measured)
    design = np.zeros((w, windows.length + 1, ny, n2 + c))
    target = np.zeros((w, windows.length + 1, ny))
    seen = np.zeros((w, windows.length + 1, ny), bool)
    x = np.zeros((w, n2, n2 + c + 1))
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
            design[:, k, :, n2:] += signals[rows][:, data.measured] * data.weight[:, None]
        if k < windows.length:
            x = np.einsum("wij,wjc->wic", intervals.A[at], x)
            x[:, :, n2:-1] += inputs[at]
            x[:, :, -1] -= intervals.defect[at]
    seen &= chosen(windows.predictable(), data.measured)
    design *= seen[..., None]
    target *= seen
    flat = design.reshape(w, -1, n2 + c)
    return [_project(flat[i], target[i].ravel(), n2, int(seen[i].sum())) for i in range(w)]


def chosen(predictable: npt.NDArray[np.bool_], measured: Ints) -> npt.NDArray[np.bool_]:
    """The measured ones of all positions and velocities."""
    return predictable if predictable.shape[2] == 1 else predictable[:, :, measured]


def _project(design: Floats, target: Floats, free: int, count: int) -> Normal:
    """Removes what the free starts explain."""
    basis, triangle = np.linalg.qr(design[:, :free])
    strength = np.abs(np.diag(triangle))
    good = strength > 1e-9 * max(strength.max(initial=0.0), 1e-300)
    basis = basis[:, good]
    rest = design[:, free:]
    rest = rest - basis @ (basis.T @ rest)
    target = target - basis @ (basis.T @ target)
    return Normal(rest.T @ rest, rest.T @ target, float(target @ target), count - int(good.sum()))


def total(normals: Sequence[Normal]) -> Normal:
    """The sum of the windows' normal equations."""
    result = normals[0]
    for one in normals[1:]:
        result = result + one
    return result


def fit(
    normal: Normal, columns: Sequence[int], ridge: Floats | None = None
) -> tuple[Floats, float]:
    """Least-squares coefficients of some columns and the sum of squares that is left.

    Args:
      ridge: [len(columns)] inverse prior variances.
    """
    index = list(columns)
    if not index:
        return np.zeros(0), normal.square
    gram = normal.gram[np.ix_(index, index)].copy()
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    if ridge is not None:
        gram = gram + np.diag(ridge)
    moment = normal.moment[index]
    scaled = gram / np.outer(scale, scale) + 1e-12 * np.eye(len(index))
    x = np.linalg.lstsq(scaled, moment / scale, rcond=1e-11)[0] / scale
    left = normal.square - 2 * x @ moment + x @ gram @ x
    return x, float(max(left, 0.0))


def profiled(normal: Normal, nuisance: Sequence[int], ridge: Floats) -> Normal:
    """Normal equations after some columns, with priors about zero, have been fitted away.

    Args:
      nuisance: the columns, which stay in place but no longer explain anything.
      ridge: [len(nuisance)] inverse prior variances.
    """
    index = list(nuisance)
    if not index:
        return normal
    inner = normal.gram[np.ix_(index, index)] + np.diag(ridge)
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    inverse = np.linalg.pinv(inner / np.outer(scale, scale), rcond=1e-11) / np.outer(scale, scale)
    across = normal.gram[:, index]
    moment = normal.moment[index]
    return Normal(
        normal.gram - across @ inverse @ across.T,
        normal.moment - across @ inverse @ moment,
        float(max(normal.square - moment @ inverse @ moment, 0.0)),
        normal.count,
    )
