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
      recording: [W].
    """

    first: Ints
    length: int
    recording: Ints

    def __len__(self) -> int:
        return len(self.first)

    def of(self, recordings: Sequence[int]) -> Windows:
        """The windows of some recordings."""
        keep = np.isin(self.recording, list(recordings))
        return Windows(self.first[keep], self.length, self.recording[keep])

    def some(self, keep: npt.NDArray[np.bool_]) -> Windows:
        """The chosen windows."""
        return Windows(self.first[keep], self.length, self.recording[keep])


def cut_windows(intervals: Intervals, length: int) -> Windows:
    """Cuts runs of usable, consecutive intervals into windows of the same length.

    A run that is no multiple of it gives a last window that overlaps the one before.
    """
    firsts: list[int] = []
    for start, stop in _runs(intervals):
        if stop - start < length:
            continue
        begins = list(range(start, stop - length + 1, length))
        if begins[-1] + length < stop - length // 2:
            begins.append(stop - length)
        firsts += begins
    first = np.array(firsts, np.int64)
    return Windows(first, length, intervals.recording[first] if len(first) else first)


def _runs(intervals: Intervals) -> Iterator[tuple[int, int]]:
    start = None
    for k in range(len(intervals.row) + 1):
        joined = (
            k < len(intervals.row)
            and intervals.usable[k]
            and (
                start is None
                or (
                    intervals.recording[k] == intervals.recording[k - 1]
                    and intervals.row[k] == intervals.row[k - 1] + 1
                )
            )
        )
        if start is not None and not joined:
            yield start, k
            start = None
        if start is None and k < len(intervals.row) and intervals.usable[k]:
            start = k


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
) -> list[Normal]:
    """Normal equations of each window.

    Args:
      noise: standard deviations of positions and velocities, each [nv]; NaN where not measured.
    """
    if not len(windows):
        return []
    nv = intervals.B.shape[2]
    inputs, signals = _stack(intervals, columns)
    data = _Data(samples, intervals, noise)
    width = 2 * nv + 1 + len(columns)
    chunk = max(1, int(_CHUNK_BYTES / (8 * (windows.length + 1) * 2 * nv * width)))
    result: list[Normal] = []
    for begin in range(0, len(windows), chunk):
        part = windows.some(np.arange(len(windows)) // chunk == begin // chunk)
        result += _chunk(intervals, part, inputs, signals, data)
    return result


def _stack(intervals: Intervals, columns: Sequence[Column]) -> tuple[Floats, Floats | None]:
    """State inputs [N, 2 nv, C] and signals [2 N, 2 nv, C] of the columns."""
    count, n2, nv = intervals.B.shape
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


class _Data:
    """Measured deviations and their weights at the ends of the intervals."""

    def __init__(
        self, samples: Sequence[Samples], intervals: Intervals, noise: tuple[Floats, Floats]
    ) -> None:
        sigma = np.concatenate(noise)
        both = [np.concatenate([s.dq, s.dv], axis=1) for s in samples]
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
    data: _Data,
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
        at = windows.first + min(k, windows.length - 1)
        values = data.starts[at] if k < windows.length else data.ends[at]
        deviation, seen[:, k] = data.rows(values)
        scaled = x[:, data.measured] * data.weight[:, None]
        target[:, k] = deviation - scaled[:, :, -1]
        design[:, k] = scaled[:, :, :-1]
        if signals is not None:
            rows = at if k < windows.length else count + at
            design[:, k, :, n2:] += signals[rows][:, data.measured] * data.weight[:, None]
        if k < windows.length:
            x = np.einsum("wij,wjc->wic", intervals.A[at], x)
            x[:, :, n2:-1] += inputs[at]
            x[:, :, -1] -= intervals.defect[at]
    design *= seen[..., None]
    target *= seen
    flat = design.reshape(w, -1, n2 + c)
    return [_project(flat[i], target[i].ravel(), n2, int(seen[i].sum())) for i in range(w)]


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


def fit(normal: Normal, chosen: Sequence[int], ridge: Floats | None = None) -> tuple[Floats, float]:
    """Least-squares coefficients of some columns and the sum of squares that is left.

    Args:
      ridge: [len(chosen)] inverse prior variances.
    """
    index = list(chosen)
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
