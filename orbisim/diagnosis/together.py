"""Several effects at once, chosen by what windows of free runs, or joints' forces, say of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.screening import candidates_of
from orbisim.diagnosis.selection import Selected, groups_of, select
from orbisim.effects import EffectInstance, effect_names, find
from orbisim.effects.catalogue import asked_once
from orbisim.effects.screening import Candidate
from orbisim.evidence import Blocks, Gain, counted, independent_share
from orbisim.host.deadline import NEVER, Deadline
from orbisim.motion.linear import Intervals, linearize, missing_force
from orbisim.motion.regressors import MotionView
from orbisim.motion.samples import Samples, extent
from orbisim.scene import Scene
from orbisim.shooting.along import along
from orbisim.shooting.bench import Bench
from orbisim.shooting.blocks import data_of
from orbisim.shooting.holding import holding
from orbisim.shooting.hypothesis import Hypothesis, bounded_instance
from orbisim.shooting.judge import Judged, is_structural
from orbisim.shooting.regress import Normal
from orbisim.shooting.windows import evenly

Floats = npt.NDArray[np.float64]
Left = TypeVar("Left")


def select_in_rounds(
    scene: Scene,
    samples: Sequence[Samples],
    found: Sequence[Candidate],
    left: Left,
    blocks: Callable[[Left], tuple[list[Normal], Blocks]],
    after: Callable[[Selected], Left],
    settled: Callable[[Left, Left], bool],
    most: int = 40,
    deadline: Deadline = NEVER,
) -> Selected:
    """Effects, chosen with data that count by what the effects chosen before leave of them.

    Args:
      found: whose columns stand in the blocks one after the other.
      left: what is known of what will be left, at first. blocks: of normal equations, weighted by
        that. after: what a selection leaves. settled: whether two of them weigh alike.
      most: effects at most. deadline: when a selection ends with what it has.
    """
    known = extent(samples)
    effects = {name: asked_once(name) for name in {one.effect for one in found}}

    def prior(instance: EffectInstance) -> float:
        return effects[instance.effect].log_prior(scene.model, instance, known)

    for _ in range(_ROUNDS):
        data = data_of(*blocks(left), deadline=deadline)
        chosen = select(data, groups_of(scene.model, found, data.whole(), prior), most)
        before, left = left, after(chosen)
        if settled(before, left) or deadline.passed:
            break
    return chosen


_ROUNDS = 3
"""The second selection has weights by effects that are there, and rarely differs from the third."""


def instances(scene: Scene, chosen: Selected) -> list[tuple[EffectInstance, Gain]]:
    """The effects that were chosen, within their bounds, with their worth."""
    found = []
    for group, x, gain in zip(chosen.groups, chosen.coefficients, chosen.gains, strict=True):
        one = group.instance(x)
        bounded = None if one is None else bounded_instance(scene, one)
        found += [] if bounded is None else [(bounded, gain)]
    return found


def left_of(chosen: Selected, columns: Floats, target: Floats) -> Floats:
    """What is left of data [...] without what chosen effects' columns [..., C] say."""
    left = target.copy()
    for group, x in zip(chosen.groups, chosen.coefficients, strict=True):
        left -= columns[..., list(group.index)] @ x
    return left


def propose(
    bench: Bench,
    intervals: Intervals,
    only: Sequence[str] | None,
    most: int,
    base: Hypothesis | None = None,
    known: Sequence[Floats] | None = None,
) -> tuple[EffectInstance, ...]:
    """Effects that together predict windows they were not fitted to, those that bring most first.

    Args:
      intervals: the linear system along the declared scene, or that of `base`.
      only: names of the effects to consider; all if None.
      most: effects at most.
      base: what is there in any case; nothing if None.
      known: for each recording what is measured beside what columns of effects say, [T, 2 nv].
    """
    base = base or Hypothesis()
    flow = bench.flow(base)
    force = missing_force(intervals)
    view = MotionView(flow, bench.samples, force)
    names = [n for n in effect_names() if (only is None or n in only) and not find(n).stated]
    found = list(candidates_of(view, bench, base, flow, names))
    if not found:
        return ()
    columns = [column for candidate in found for column in candidate.columns]
    windows = bench.windows.some(evenly(bench.fit, _MOST_WINDOWS))
    data = holding(bench, intervals, windows, columns, known)
    # dry friction may hold a joint at rest with any force that is usual of it
    normals = data.normals(3 * np.sqrt(np.nanmean(force**2, axis=0)) + 1e-12)

    def blocks(share: float) -> tuple[list[Normal], Blocks]:
        return normals, counted(data.count, share)

    def after(chosen: Selected) -> float:
        left = left_of(chosen, data.design, data.target)
        course = left.reshape(len(left), windows.length + 1, -1)
        return independent_share([c for window in course for c in window.T])

    def settled(before: float, share: float) -> bool:
        return bool(abs(np.log(share / before)) < _ALIKE)

    chosen = select_in_rounds(
        bench.scene, bench.samples, found, _SHARE, blocks, after, settled, most, bench.deadline
    )
    return tuple(one for one, _ in instances(bench.scene, chosen))


def propose_anew(
    bench: Bench, judged: Judged, only: Sequence[str] | None, most: int
) -> Hypothesis | None:
    """As if the effects of an explanation had not been chosen yet, along its own free runs: chosen
    along the recordings, where late sensors and missing forces bend the motion, several may stand
    for one. None where an added joint hides the motion, or nothing is chosen.

    Args:
      only: as of `propose`. most: effects at most, those that bring most.
    """
    there = judged.hypothesis
    kept = tuple(one for one in there.effects if find(one.effect).stated)
    base = dataclasses.replace(there, effects=kept, frozen=frozenset())
    seen = None if is_structural(there) else along(bench, there, judged.windows, judged.fit.start)
    if seen is None:
        return None
    local, _ = seen
    flow = local.flow(base)
    intervals = linearize(flow)
    known = _beyond(local, there, MotionView(flow, local.samples, missing_force(intervals)))
    found = propose(local, intervals, only, most, base, known)[: max(most - len(kept), 0)]
    return dataclasses.replace(base, effects=(*kept, *found)).in_parts() if found else None


def _beyond(bench: Bench, hypothesis: Hypothesis, view: MotionView) -> list[Floats]:
    """What measurement effects of a hypothesis add to each recording beyond their columns, [T, 2
    nv], at the ends of intervals: a delay of many samples is no velocity times a number."""
    known = bench.known_signal(hypothesis)
    names = {(one.effect, one.target) for one in hypothesis.effects if find(one.effect).measurement}
    found = [one for name, target in names for one in find(name).screen(view, target)]
    columns = [c.values for one in found for c in one.columns if c.kind == "signal"]
    recording = np.tile(view.flow.recording, 2)
    row = np.concatenate([view.flow.row, view.flow.row + 1])
    signal = np.array([known[i][r] for i, r in zip(recording, row, strict=True)])
    if columns:
        design = np.array([np.nan_to_num(c).ravel() for c in columns]).T
        said = design @ np.linalg.lstsq(design, signal.ravel(), rcond=None)[0]
        signal = signal - said.reshape(signal.shape)
    beyond = [np.zeros_like(one) for one in known]
    for i, r, value in zip(recording, row, signal, strict=True):
        beyond[i][r] = value
    return beyond


_MOST_WINDOWS = 120
"""Their normal equations with all effects' columns take some 100 MB."""
_SHARE = 0.05
"""Share of data that counts as independent, until it is known what is left."""
_ALIKE = 0.5
"""Logarithm of the ratio of two shares of independent data that select alike."""
