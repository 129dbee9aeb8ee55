"""Regression over windows in which joints may stand still.

Where a joint stands still, dry friction may hold it with any force up to its level, and the sign of
the velocity says nothing. There, and only there, an unknown force at the joint is fitted too,
piecewise linear in time and of limited size (generalized least squares: as process noise of a
state-space model).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from orbisim.effects.screening import Column
from orbisim.motion.linear import Intervals
from orbisim.shooting.bench import Bench
from orbisim.shooting.regress import Normal, WeightedData, projected, stacked
from orbisim.shooting.windows import Windows, hats_at

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

_KNOTS = 12
"""Knots of the unknown force in a window at most."""
_SPACING = 4
"""Samples between knots at least."""


@dataclasses.dataclass(frozen=True, eq=False)
class Holding:
    """Windows with the forces that may hold joints.

    Attributes:
      design: [W, R, C] weighted columns of effects, after window starts were projected out.
      target: [W, R] weighted data, likewise. knots: [W, R, F] what unit forces at the knots give.
      still: [W, F] whether the joint stands still at the knot. dof: [F] of the knots.
      count: [W] data less fitted starts.
    """

    design: Floats
    target: Floats
    knots: Floats
    still: Bools
    dof: Ints
    count: Ints

    def normals(self, size: Floats) -> list[Normal]:
        """Normal equations of each window with holding forces of such a size.

        Args:
          size: [nv] standard deviation of the force that may hold a joint.
        """
        found = []
        for w in range(len(self.target)):
            both = np.column_stack([self.design[w], self.target[w]])
            gram = self._whitened(w, size, both)
            found.append(
                Normal(gram[:-1, :-1], gram[:-1, -1], float(gram[-1, -1]), int(self.count[w]))
            )
        return found

    def _std(self, w: int, size: Floats) -> Floats:
        return np.asarray(size[self.dof] * np.where(self.still[w], 1.0, 0.0))

    def _whitened(self, w: int, size: Floats, values: Floats) -> Floats:
        """values' (I + K S K')^-1 values, with knots K and their variances S."""
        matrix = self.knots[w] * self._std(w, size)
        inner = matrix.T @ matrix + np.eye(matrix.shape[1])
        across = matrix.T @ values
        gram = values.T @ values - across.T @ np.linalg.solve(inner, across)
        return np.asarray((gram + gram.T) / 2)


def holding(
    bench: Bench,
    intervals: Intervals,
    windows: Windows,
    columns: Sequence[Column],
    known: Sequence[Floats] | None = None,
) -> Holding:
    """Windows of a bench with columns of effects and forces that may hold joints.

    Args:
      intervals: the linear system along the scene that is examined.
      known: for each recording what measurement effects add to it, [T, 2 nv].
    """
    k = windows.length
    knots = int(np.clip(k // _SPACING + 1, 2, _KNOTS))
    places = np.linspace(0, k - 1, knots)
    hats = hats_at(places, k)
    inputs, signals = stacked(intervals, columns)
    data = WeightedData(bench.samples, intervals, bench.noise, known)
    width = knots * intervals.B.shape[2]

    def push(sample: int, at: Ints) -> Floats:
        """What forces at the knots do over the intervals that follow a sample."""
        share = hats[min(sample, k - 1)]
        return np.asarray(
            np.einsum("wij,h->wihj", intervals.B[at], share).reshape(len(at), -1, width)
        )

    parts = projected(intervals, windows, inputs, signals, data, push)
    return Holding(
        design=np.array([p.design[:, width:] for p in parts]),
        target=np.array([p.target for p in parts]),
        knots=np.array([p.design[:, :width] for p in parts]),
        still=_still(bench, intervals, windows, places),
        dof=np.tile(np.arange(intervals.B.shape[2]), knots),
        count=np.array([p.rows for p in parts]),
    )


def _still(bench: Bench, intervals: Intervals, windows: Windows, places: Floats) -> Bools:
    """[W, F]: whether a joint's velocity cannot be told from zero about a knot."""
    found = []
    for first, number in zip(windows.first, windows.recording, strict=True):
        one = bench.samples[number]
        row = int(intervals.row[first])
        speed = np.abs(one.qvel[row : row + windows.length + 1])
        step = float(np.median(np.diff(one.time)))
        blur = np.nan_to_num(one.q_noise) / step
        near = np.array([speed[round(p)] < blur for p in places])
        found.append(near.ravel())
    return np.array(found)
