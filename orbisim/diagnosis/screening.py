"""Every effect at every target, as a linear regression along the measured motion."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.bench import Bench, Hypothesis, clean, completed
from orbisim.diagnosis.linear import IntervalMap, Intervals, linearize
from orbisim.diagnosis.regress import Normal, fit, normal_equations, total
from orbisim.diagnosis.view import MotionView
from orbisim.effects import EffectInstance, add_effects, effect_names, find
from orbisim.effects.screening import Candidate, Column
from orbisim.errors import OrbiSimError

Floats = npt.NDArray[np.float64]

_SMOOTH = 7


@dataclasses.dataclass(frozen=True, eq=False)
class Suspect:
    """An effect with first estimates of its parameters.

    Attributes:
      instance: the effect. bic: difference of the Bayesian information criterion to no effect, in
        linear approximation (negative is better). ratio: residual over noise with it.
    """

    instance: EffectInstance
    bic: float
    ratio: float


@dataclasses.dataclass(frozen=True, eq=False)
class Screening:
    """Result of a screening.

    Attributes:
      suspects: best first, one for each effect, target and options.
      ratio: residual over noise without any of them.
      shares: [nv] share of the residual that a missing force at each degree of freedom explains.
      force: [N, nv] missing generalized force over every sampling interval.
      intervals: the linear system along the scene that was screened.
    """

    suspects: tuple[Suspect, ...]
    ratio: float
    shares: Floats
    force: Floats
    intervals: Intervals


def screen(bench: Bench, hypothesis: Hypothesis, only: Sequence[str] | None = None) -> Screening:
    """Looks for effects that would explain what a hypothesis leaves.

    Args:
      only: names of the effects to consider; all if None.
    """
    scene = hypothesis.scene(bench.scene)
    flow = bench.flow(scene)
    intervals = linearize(flow)
    view = MotionView(flow, bench.samples)
    view.missing_force = missing_force(intervals)
    found = list(_candidates(view, bench, hypothesis, flow, only))
    columns = [column for candidate in found for column in candidate.columns]
    by_dof = _force_columns(view.missing_force, flow)
    windows = bench.windows.some(bench.fit)
    normals = normal_equations(bench.samples, intervals, windows, [*columns, *by_dof], bench.noise)
    normal = total(normals)
    suspects = _rank(found, normal, bench)
    return Screening(
        suspects=tuple(suspects),
        ratio=float(np.sqrt(normal.square / max(normal.count, 1))),
        shares=_shares(normal, len(columns), len(by_dof)),
        force=view.missing_force,
        intervals=intervals,
    )


def missing_force(intervals: Intervals) -> Floats:
    """The constant generalized force over each interval that fits its defect best, [N, nv].

    Weighted by what a force does to velocities: positions hardly move within an interval.
    """
    nv = intervals.B.shape[2]
    b, d = intervals.B[:, nv:], intervals.defect[:, nv:]
    force = np.full((len(d), nv), np.nan)
    good = intervals.usable
    force[good] = np.linalg.solve(b[good], d[good][..., None])[..., 0]
    return force


def _candidates(
    view: MotionView,
    bench: Bench,
    hypothesis: Hypothesis,
    flow: IntervalMap,
    only: Sequence[str] | None,
) -> list[Candidate]:
    model = bench.scene.model
    taken = {(e.effect, e.target) for e in hypothesis.effects}
    found: list[Candidate] = []
    base: tuple[Floats, Floats] | None = None
    for name in effect_names():
        effect = find(name)
        if only is not None and name not in only:
            continue
        for target in effect.targets(model):
            if (name, target) in taken:
                continue
            offered = effect.screen(view, target)
            found += offered
            if not offered and not effect.structural and effect.native:
                base = flow.advance() if base is None else base
                found += _by_difference(bench, hypothesis, flow, base, name, target)
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
    scene = hypothesis.scene(bench.scene)
    found: list[Candidate] = []
    for values in find(name).trials(bench.scene.model, target):
        try:
            changed = add_effects(scene, [EffectInstance(name, target, dict(values))])
        except OrbiSimError:
            continue
        difference = flow.tangent(*base, *flow.advance(scene=changed))
        column = Column("state", np.nan_to_num(difference, posinf=0.0, neginf=0.0))
        if np.abs(column.values).max() > 0:
            kept = dict(values)
            found.append(
                Candidate(name, target, (column,), lambda c, v=kept: v, fixed=True, shape=1)
            )
    return found


def _rank(found: Sequence[Candidate], normal: Normal, bench: Bench) -> list[Suspect]:
    """Suspects by information criterion; the best shape of each effect at each target."""
    best: dict[tuple[str, ...], Suspect] = {}
    start = 0
    for candidate in found:
        index = list(range(start, start + len(candidate.columns)))
        start += len(candidate.columns)
        coefficients, left = _solve(candidate, normal, index)
        values = candidate.solve(coefficients)
        if values is None or not np.isfinite(left):
            continue
        suspect = _suspect(candidate, values, left, normal, bench)
        key = (candidate.effect, candidate.target, *sorted(candidate.options.values()))
        if key not in best or suspect.bic < best[key].bic:
            best[key] = suspect
    return sorted(best.values(), key=lambda s: s.bic)


def _solve(candidate: Candidate, normal: Normal, index: list[int]) -> tuple[Floats, float]:
    if not candidate.fixed:
        return fit(normal, index)
    i = index[0]
    left = normal.square - 2 * normal.moment[i] + normal.gram[i, i]
    return np.ones(1), float(max(left, 0.0))


def _suspect(
    candidate: Candidate, values: object, left: float, normal: Normal, bench: Bench
) -> Suspect:
    instance = EffectInstance(
        candidate.effect,
        candidate.target,
        dict(values),
        dict(candidate.options),  # type: ignore[call-overload]
    )
    free = find(candidate.effect).free_parameters(bench.scene.model, candidate.target)
    penalty = len(free) * np.log(max(normal.count, 2))
    before, after = (max(x, normal.count) for x in (normal.square, left))
    bic = (
        normal.count * np.log(after / before) + penalty
        if before > normal.count
        else (left - normal.square + penalty)
    )
    return Suspect(instance, float(bic), float(np.sqrt(left / max(normal.count, 1))))


def _force_columns(force: Floats, flow: IntervalMap) -> list[Column]:
    """The smoothed missing force of each degree of freedom by itself."""
    smooth = np.nan_to_num(force)
    kernel = np.ones(_SMOOTH) / _SMOOTH
    found: list[Column] = []
    for j in range(force.shape[1]):
        values = np.zeros((2 * len(force), force.shape[1]))
        course = np.convolve(smooth[:, j], kernel, mode="same")
        values[: len(force), j] = values[len(force) :, j] = course
        found.append(Column("force", values))
    return found


def _shares(normal: Normal, first: int, count: int) -> Floats:
    gains = np.array([max(normal.square - fit(normal, [first + j])[1], 0.0) for j in range(count)])
    return gains / gains.sum() if gains.sum() > 0 else gains


def cleaned(bench: Bench, suspect: Suspect) -> EffectInstance | None:
    """The suspect's effect with all parameters within their bounds; None if it is not possible."""
    instance = suspect.instance
    effect = find(instance.effect)
    names = effect.free_parameters(bench.scene.model, instance.target)
    try:
        if all(name in instance.values for name in names):
            free = {name: instance.values[name] for name in names}
            instance = completed(bench.scene, instance, free)
        else:
            instance = clean(bench.scene, instance)
        effect.check(bench.scene.model, instance)
    except (OrbiSimError, KeyError):
        return None
    return instance
