"""Several effects at once from free runs: a proposal for where single ones fall short."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.screening import bounded_instance, candidates_of
from orbisim.diagnosis.selection import Group, Selected, data_of, groups_of, select
from orbisim.effects import EffectInstance, effect_names, find
from orbisim.evidence import Blocks, independent_share
from orbisim.motion.linear import Intervals, missing_force
from orbisim.motion.regressors import MotionView
from orbisim.motion.samples import extent
from orbisim.shooting.bench import Bench
from orbisim.shooting.holding import holding
from orbisim.shooting.hypothesis import Hypothesis

Floats = npt.NDArray[np.float64]

_MOST_WINDOWS = 120
_ROUNDS = 2
_SHARE = 0.05
"""Share of data that counts as independent, until it is known what is left."""


def propose(
    bench: Bench, intervals: Intervals, only: Sequence[str] | None, most: int
) -> tuple[EffectInstance, ...]:
    """Effects that together predict windows they were not fitted to, those that bring most first.

    Args:
      intervals: the linear system along the declared scene.
      only: names of the effects to consider; all if None.
      most: effects at most.
    """
    declared = Hypothesis()
    flow = bench.flow(declared)
    view = MotionView(flow, bench.samples)
    view.missing_force = missing_force(intervals)
    names = [n for n in effect_names() if (only is None or n in only) and not find(n).stated]
    found = list(candidates_of(view, bench, declared, flow, names))
    if not found:
        return ()
    columns = [column for candidate in found for column in candidate.columns]
    windows = bench.windows.some(_thinned(bench.fit))
    data = holding(bench, intervals, windows, columns)
    model, known = bench.scene.model, extent(bench.samples)

    def prior(instance: EffectInstance) -> float:
        return find(instance.effect).log_prior(model, instance, known)

    normals = data.normals(_holding(view.missing_force))
    share, effects = _SHARE, tuple[EffectInstance, ...]()
    for _ in range(_ROUNDS):
        size = np.maximum(data.count * share, 1.0)
        counts = Blocks(size, np.zeros(len(size), np.int64), np.ones(len(size)))
        blocks = data_of(normals, counts, deadline=bench.deadline)
        chosen = select(blocks, groups_of(model, found, blocks.whole(), prior), most)
        effects, before = _instances(bench, chosen), share
        share = independent_share(_courses(data.design, data.target, chosen, windows.length))
        if abs(np.log(share / before)) < _ALIKE:
            break
    return effects


_ALIKE = 0.5
"""Logarithm of the ratio of two shares of independent data that select alike."""


def _courses(design: Floats, target: Floats, chosen: Selected, length: int) -> list[Floats]:
    """What a selection leaves of each signal in each window."""
    left = target.copy()
    for group, x in zip(chosen.groups, chosen.coefficients, strict=True):
        left -= design[:, :, list(group.index)] @ x
    course = left.reshape(len(left), length + 1, -1)
    return [course[w, :, c] for w in range(course.shape[0]) for c in range(course.shape[2])]


def _thinned(keep: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    every = np.flatnonzero(keep)
    some = every[np.unique(np.linspace(0, len(every) - 1, _MOST_WINDOWS).round().astype(int))]
    out = np.zeros_like(keep)
    out[some] = True
    return out


def _holding(force: Floats) -> Floats:
    """[nv]: standard deviation of the force by which dry friction may hold a joint at rest."""
    return np.asarray(3 * np.sqrt(np.nanmean(force**2, axis=0)) + 1e-12)


def _instances(bench: Bench, chosen: Selected) -> tuple[EffectInstance, ...]:
    pairs: list[tuple[Group, Floats]] = list(zip(chosen.groups, chosen.coefficients, strict=True))
    found = [group.instance(x) for group, x in pairs]
    bounded = [bounded_instance(bench.scene, one) for one in found if one is not None]
    return tuple(one for one in bounded if one is not None)
