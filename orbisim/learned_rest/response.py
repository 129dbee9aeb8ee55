"""How windows respond to a missing force: quadratic in the force, in linear approximation.

Along the linear system of `orbisim.motion.linear`, the weighted squared residual of a window,
its free start projected out, is

    square - 2 moment . f + f . gram f

for generalized forces f, each held over one or several sampling intervals.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from orbisim.motion.linear import Intervals
from orbisim.shooting.bench import Bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.regress import normal_of, without_start
from orbisim.shooting.windows import Windows, chosen, evenly

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

_MOST_PIECES = 50
"""Pieces over which forces are held: responses grow with the square of their number."""
_MOST_NUMBERS = 4e7
"""Numbers that the responses of all windows may take: 320 MB."""


@dataclasses.dataclass(frozen=True, eq=False)
class Responses:
    """Of W windows, to forces held over P pieces of each in D degrees of freedom.

    Attributes:
      gram: [W, P * D, P * D]. moment: [W, P * D]. square: [W]. count: [W] number of data, less
        those that fix the start.
      piece: [K] the piece in which each interval of a window lies.
      number: [W, K] of the intervals.
    """

    gram: Floats
    moment: Floats
    square: Floats
    count: Floats
    piece: Ints
    number: Ints

    def some(self, keep: npt.NDArray[np.bool_]) -> Responses:
        """Those of some windows."""
        return Responses(
            self.gram[keep], self.moment[keep], self.square[keep], self.count[keep], self.piece,
            self.number[keep],
        )  # fmt: skip


def affordable(windows: Windows, dofs: int) -> npt.NDArray[np.bool_]:
    """[W]: as many windows, spread evenly, as the responses of fit into memory."""
    pieces = min(windows.length, _MOST_PIECES)
    most = max(8, int(_MOST_NUMBERS / (pieces * dofs) ** 2))
    return evenly(np.ones(len(windows), bool), most)


def responses(
    bench: Bench, hypothesis: Hypothesis, intervals: Intervals, windows: Windows, dofs: Ints
) -> Responses:
    """Responses of windows to forces at some degrees of freedom.

    Args:
      intervals: the linear system along the hypothesis. dofs: [D].
    """
    stride = int(np.ceil(windows.length / _MOST_PIECES))
    piece = np.arange(windows.length) // stride
    sigma = np.concatenate(bench.noise)
    measured = np.flatnonzero(np.isfinite(sigma))
    known = bench.known_signal(hypothesis)
    deviation = [
        (np.concatenate([one.dq, one.dv], axis=1) - added)[:, measured] / sigma[measured]
        for one, added in zip(bench.samples, known, strict=True)
    ]
    seen = chosen(windows.predictable(), measured)
    parts = []
    for w, first in enumerate(windows.first):
        number = first + np.arange(windows.length)
        rows = intervals.row[first] + np.arange(windows.length + 1)
        target = deviation[windows.recording[w]][_within(rows, deviation[windows.recording[w]])]
        design, offset = _course(intervals, number, dofs, piece, int(windows.reach()[w]))
        design = design[:, measured] / sigma[measured][:, None]
        target = target - offset[:, measured] / sigma[measured]
        good = np.isfinite(target) & seen[w]
        kept = without_start(design[good], target[good], intervals.A.shape[1], int(good.sum()))
        parts.append(normal_of(*kept))
    return Responses(
        gram=np.array([one.gram for one in parts]),
        moment=np.array([one.moment for one in parts]),
        square=np.array([one.square for one in parts]),
        count=np.array([float(one.count) for one in parts]),
        piece=piece,
        number=windows.first[:, None] + np.arange(windows.length),
    )


def _within(rows: Ints, values: Floats) -> Ints:
    return np.minimum(rows, len(values) - 1)


def _course(
    intervals: Intervals, number: Ints, dofs: Ints, piece: Ints, reach: int
) -> tuple[Floats, Floats]:
    """Derivatives [K + 1, 2 nv, 2 nv + P * D] of a window's states by its start and forces, and its
    states without any [K + 1, 2 nv]; constant beyond what can be predicted."""
    n2, width = intervals.A.shape[1], len(dofs)
    x = np.zeros((n2, n2 + (int(piece[-1]) + 1) * width + 1))
    x[:, :n2] = np.eye(n2)
    out = np.empty((len(number) + 1, *x.shape))
    out[0] = x
    last = len(intervals.A) - 1
    for k, i in enumerate(number):
        if k < reach and i <= last:
            x = intervals.A[i] @ x
            at = n2 + int(piece[k]) * width
            x[:, at : at + width] += intervals.B[i][:, dofs]
            x[:, -1] -= intervals.defect[i]
        out[k + 1] = x
    return out[..., :-1], out[..., -1]
