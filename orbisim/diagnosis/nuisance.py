"""What else may change while an effect is looked for: declared parameters, and the parameters of
effects that were found before."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from orbisim.effects import find
from orbisim.effects.screening import Column
from orbisim.motion.linear import IntervalMap
from orbisim.shooting.bench import Bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.regress import Normal, fit, profiled
from orbisim.shooting.retune import Tunable, retuned

Floats = npt.NDArray[np.float64]

_TUNE_STEP = 1e-3
"""Relative step of differences: a thirtieth of a factor's prior standard deviation."""


def factor_columns(bench: Bench, chosen: Sequence[Tunable]) -> Floats:
    """Change of every interval's end for each unit of a factor, [N, 2 nv, F], by simulation."""
    flow = bench.flow(Hypothesis())
    base = flow.advance()
    out = np.zeros((len(flow), 2 * flow.model.nv, len(chosen)))
    for f, one in enumerate(chosen):
        moved = flow.advance(scene=retuned(bench.scene, {one: 1 + _TUNE_STEP}))
        change = flow.tangent(*base, *moved) / _TUNE_STEP
        out[:, :, f] = np.nan_to_num(change, posinf=0.0, neginf=0.0)
    return out


@dataclasses.dataclass(frozen=True, eq=False)
class Apart:
    """Normal equations after the columns of a hypothesis' own parameters have been fitted away.

    Attributes:
      normal: what is left; columns that say nothing else are zero.
      whole: with the own columns. own: where these stand. which: numbers of their parameters.
      count: of all own parameters.
    """

    normal: Normal
    whole: Normal
    own: tuple[int, ...]
    which: tuple[int, ...]
    count: int

    def moved(self, index: Sequence[int], coefficients: Floats) -> Floats:
        """[P]: change of the own parameters when some columns have these coefficients."""
        explained = self.whole.gram[:, list(index)] @ coefficients
        left = dataclasses.replace(self.whole, moment=self.whole.moment - explained)
        change = np.zeros(self.count)
        change[list(self.which)] = fit(left, self.own)[0]
        return change


@dataclasses.dataclass(frozen=True, eq=False)
class OwnColumns:
    """What the free parameters of a hypothesis' effects change, for each unit.

    Attributes:
      columns: of those that have any. which: their numbers. count: of all free parameters.
    """

    columns: tuple[Column, ...]
    which: tuple[int, ...]
    count: int

    def apart(self, normal: Normal, own: Sequence[int]) -> Apart:
        """Fits the own columns away.

        Args:
          own: where they stand in the normal equations.
        """
        rest = profiled(normal, own, np.zeros(len(own)))
        same = np.diag(rest.gram) < _NEW * np.diag(normal.gram)
        gram, moment = rest.gram.copy(), rest.moment.copy()
        gram[same], gram[:, same], moment[same] = 0.0, 0.0, 0.0
        rest = dataclasses.replace(rest, gram=gram, moment=moment)
        return Apart(rest, normal, tuple(own), self.which, self.count)


_NEW = 1e-6
"""Share of a column that must not be in the span of the others."""


def own_columns(bench: Bench, hypothesis: Hypothesis, flow: IntervalMap) -> OwnColumns:
    """What the free parameters of a hypothesis' effects change, by simulation; not of those that
    add joints, whose state nothing reads.

    Args:
      flow: of the hypothesis.
    """
    free = hypothesis.free(bench.scene)
    if not free:
        return OwnColumns((), (), 0)
    values, unknowns = hypothesis.values(bench.scene), hypothesis.unknowns(bench.scene)
    base, seen = flow.advance(), bench.known_signal(hypothesis)
    columns: list[Column] = []
    which: list[int] = []
    for k, (number, _) in enumerate(free):
        effect = find(hypothesis.effects[number].effect)
        if effect.structural:
            continue
        step = unknowns[k].step_from(float(values[k]))
        moved = values.copy()
        moved[k] += step
        other = hypothesis.at(bench.scene, moved)
        change = [b - a for a, b in zip(seen, bench.known_signal(other), strict=True)]
        if any(one.any() for one in change):
            pairs = list(zip(flow.recording, flow.row, strict=True))
            ends = [change[i][r] for i, r in pairs] + [change[i][r + 1] for i, r in pairs]
            columns.append(Column("signal", np.array(ends) / step))
        else:
            difference = flow.tangent(*base, *bench.flow(other).advance())
            difference = np.nan_to_num(difference, posinf=0.0, neginf=0.0)
            columns.append(Column("state", difference / step))
        which.append(k)
    return OwnColumns(tuple(columns), tuple(which), len(free))
