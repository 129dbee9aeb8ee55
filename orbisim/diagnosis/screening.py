"""Every effect at every target, as a linear regression along the measured motion."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.nuisance import Apart, own_columns
from orbisim.diagnosis.suspects import Screening, Suspect, merged
from orbisim.effects import EffectInstance, add_effects, effect_names, find
from orbisim.effects.screening import Candidate, Column, Solve
from orbisim.errors import OrbiSimError
from orbisim.motion.linear import IntervalMap, Intervals, missing_force, smoothed_force
from orbisim.motion.regressors import MotionView
from orbisim.scene import Scene
from orbisim.shooting.bench import Bench
from orbisim.shooting.hypothesis import Hypothesis, bounded_instance
from orbisim.shooting.regress import (
    Normal,
    fit,
    force_columns,
    levelled,
    normal_equations,
    profiled,
    total,
    with_ones,
)
from orbisim.shooting.retune import SPREAD

Floats = npt.NDArray[np.float64]


def screen(
    bench: Bench,
    hypothesis: Hypothesis,
    intervals: Intervals,
    only: Sequence[str] | None = None,
    factors: Floats | None = None,
    force: Floats | None = None,
) -> Screening:
    """Looks for effects that would explain what a hypothesis leaves, also where its own effects
    take other values then.

    Args:
      intervals: the linear system along the hypothesis.
      only: names of the effects to consider; all if None.
      factors: [N, 2 nv, F] change of every interval's end by factors of declared parameters.
      force: [N, nv] missing force, where it is known better than from the intervals.
    """
    flow = bench.flow(hypothesis)
    force = missing_force(intervals) if force is None else force
    view = MotionView(flow, bench.samples, force)
    found = list(candidates_of(view, bench, hypothesis, flow, only))
    columns = [column for candidate in found for column in candidate.columns]
    first = len(columns)
    columns += force_columns(smoothed_force(force))
    nuisance = [] if factors is None else [Column("state", f) for f in np.moveaxis(factors, 2, 0)]
    own = own_columns(bench, hypothesis, flow)
    windows = bench.windows.some(bench.fit)
    known = bench.known_signal(hypothesis)
    both = [*columns, *nuisance, *own.columns]
    normals = normal_equations(bench.samples, intervals, windows, both, bench.noise, known)
    index = list(range(len(columns), len(columns) + len(nuisance)))
    after = list(range(len(columns) + len(nuisance), len(both)))

    def ranked(normal: Normal) -> Screening:
        """Suspects, and those when declared parameters may be retuned too."""
        apart = own.apart(normal, after)
        tuned = profiled(apart.normal, index, np.full(len(index), 1 / SPREAD**2))
        return Screening(
            suspects=tuple(_rank(found, apart.normal, bench, apart)),
            shares=_shares(normal, first, len(columns) - first),
            tuned=tuple(_rank(found, tuned, bench)) if index else (),
        )

    every = ranked(total(normals))
    return merged(every, ranked(total(levelled(normals)))) if hypothesis.effects else every


def candidates_of(
    view: MotionView,
    bench: Bench,
    hypothesis: Hypothesis,
    flow: IntervalMap,
    only: Sequence[str] | None,
    simulated: bool = True,
) -> list[Candidate]:
    """Candidates of effects at all their targets; `only` these effects, or all if None.

    Args:
      simulated: also of those that no regressor of the motion says, by simulation.
    """
    model = bench.scene.model
    taken = {(e.effect, e.target) for e in hypothesis.effects}
    found: list[Candidate] = []
    ends = functools.cache(flow.advance)
    for name in effect_names():
        effect = find(name)
        if only is not None and name not in only:
            continue
        for target in effect.targets(model):
            if (name, target) in taken:
                continue
            offered = effect.screen(view, target)
            found += offered
            if simulated and not offered and not effect.structural and effect.native:
                found += _by_difference(bench, hypothesis, flow, ends(), name, target)
    return found


def _by_difference(
    bench: Bench,
    hypothesis: Hypothesis,
    flow: IntervalMap,
    base: tuple[Floats, Floats],
    name: str,
    target: str,
) -> list[Candidate]:
    """The change of every interval's end at a few parameter values, by simulation."""
    scene, felt = hypothesis.scene(bench.scene), flow.felt(find(name), target)
    found: list[Candidate] = []
    for values in find(name).trials(bench.scene.model, target) if felt.any() else ():
        try:
            changed = add_effects(scene, [EffectInstance(name, target, dict(values))])
        except OrbiSimError:
            continue
        difference = flow.tangent(*base, *flow.advance(scene=changed, only=felt))
        column = Column("state", np.nan_to_num(difference, posinf=0.0, neginf=0.0))
        if np.abs(column.values).max() > 0:
            kept = dict(values)
            solve: Solve = functools.partial(_constant, kept)
            found.append(Candidate(name, target, (column,), solve, fixed=True, shape=1))
    return found


def _constant(values: Mapping[str, float], _: Floats) -> Mapping[str, float]:
    return values


class _Form(NamedTuple):
    """A candidate with the numbers of its columns, their coefficients, and what it leaves alone."""

    candidate: Candidate
    columns: list[int]
    coefficients: Floats
    left: float

    @property
    def key(self) -> tuple[str, ...]:
        """Forms of the same key differ in shape alone."""
        one = self.candidate
        return (one.effect, one.target, *sorted(one.options.values()))


def _forms(found: Sequence[Candidate], normal: Normal) -> Iterator[_Form]:
    start = 0
    for candidate in found:
        index = list(range(start, start + len(candidate.columns)))
        start += len(candidate.columns)
        coefficients, left = _solve(candidate, normal, index)
        if np.isfinite(left):
            yield _Form(candidate, index, coefficients, left)


def _rank(
    found: Sequence[Candidate], normal: Normal, bench: Bench, apart: Apart | None = None
) -> list[Suspect]:
    """Possible suspects by information criterion; the best shape of each effect at each target."""
    best: dict[tuple[str, ...], tuple[float, _Form]] = {}
    for form in _forms(found, normal):
        if form.candidate.solve(form.coefficients) is None:
            continue
        bic = _bic(form.left, _numbers(form.candidate, bench), normal)
        if form.key not in best or bic < best[form.key][0]:
            best[form.key] = bic, form
    ranked = []
    for bic, form in sorted(best.values(), key=lambda one: one[0]):
        candidate, index, coefficients, _ = form
        instance = _instance(bench.scene, candidate, coefficients)
        if instance is None:
            continue
        suspect = Suspect(instance, bic)
        if apart is not None:
            suspect = dataclasses.replace(suspect, moved=apart.moved(index, coefficients))
        if not candidate.fixed:
            sized = functools.partial(_sized, bench.scene, candidate, coefficients)
            suspect = dataclasses.replace(suspect, sized=sized)
        ranked.append(suspect)
    return ranked


def _bic(left: float, numbers: int, normal: Normal) -> float:
    """Difference of the Bayesian information criterion to nothing."""
    before, after = (max(x, normal.count) for x in (normal.square, left))
    penalty = numbers * np.log(max(normal.count, 2))
    if before > normal.count:
        return float(normal.count * np.log(after / before) + penalty)
    return float(left - normal.square + penalty)


def _solve(candidate: Candidate, normal: Normal, index: list[int]) -> tuple[Floats, float]:
    if not candidate.fixed:
        strength = np.diag(normal.gram)[index]
        felt = strength > 1e-12 * strength.max(initial=0.0)
        coefficients = np.zeros(len(index))
        coefficients[felt], left = fit(normal, [i for i, f in zip(index, felt, strict=True) if f])
        return coefficients, left
    return np.ones(1), max(with_ones(normal, index).square, 0.0)


def _numbers(candidate: Candidate, bench: Bench) -> int:
    """How many numbers an effect adds."""
    return len(find(candidate.effect).free_parameters(bench.scene.model, candidate.target))


def _shares(normal: Normal, first: int, count: int) -> Floats:
    gains = np.array([max(normal.square - fit(normal, [first + j])[1], 0.0) for j in range(count)])
    return gains / gains.sum() if gains.sum() > 0 else gains


def _instance(scene: Scene, one: Candidate, coefficients: Floats) -> EffectInstance | None:
    """A candidate's effect with such coefficients; None if it is not possible."""
    values = one.solve(coefficients)
    if values is None:
        return None
    made = EffectInstance(one.effect, one.target, dict(values), dict(one.options))
    return bounded_instance(scene, made)


def _sized(
    scene: Scene, candidate: Candidate, coefficients: Floats, size: float
) -> EffectInstance | None:
    """A candidate's effect where its coefficients are so many times as large."""
    return _instance(scene, candidate, size * coefficients)
