"""What is determined only together: "the mass at one link or the next: only the sum".

To the effects that were found, what would do the same at other places is added, a little of each,
and the Jacobian of all of them tells which numbers have no value of their own (see
`orbisim.shooting.ties`). Nothing is fitted or searched.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.conclusion import Attribution
from orbisim.diagnosis.force_search import ForceAttribution, jacobian
from orbisim.diagnosis.found import Combination, Term
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.wording import together
from orbisim.diagnosis.worth import independent_data
from orbisim.effects import find
from orbisim.errors import OrbiSimError
from orbisim.host.deadline import Deadline, TimeIsUpError
from orbisim.scene import Scene
from orbisim.shooting.confidence import confidence
from orbisim.shooting.elsewhere import Wide, widened
from orbisim.shooting.fits import Fit
from orbisim.shooting.gauss_newton import gauss_newton
from orbisim.shooting.shooter import Shooter, Variant
from orbisim.shooting.ties import tied

Floats = npt.NDArray[np.float64]


def combined_in_runs(found: Attribution, settings: Settings) -> tuple[Combination, ...]:
    """Of free runs, by their derivatives from the starts that were fitted."""
    hypothesis, after, bench = found.hypothesis, found.after, found.bench
    if not hypothesis.effects:
        return ()
    scene, limit = bench.scene, Deadline.after(_OF_TIME * settings.patience)
    shooter = Shooter(scene, bench.samples, bench.intervals, after.windows, bench.noise, limit)

    def build(values: Floats) -> Variant:
        return wide.whole.at(scene, values).variant(scene)

    try:
        wide = widened(scene, bench.samples, hypothesis, settings.effects)
        unknowns, start = wide.whole.unknowns(scene), after.fit.start
        every = gauss_newton(shooter, build, unknowns, start=start, iterations=0)
    except (OrbiSimError, TimeIsUpError):
        return ()
    gram = every.information.sum(axis=0) + np.diag([one.precision for one in unknowns])
    return _combined(scene, wide, after.fit, gram, settings.seed, independent_data(after))


_OF_TIME = 0.02
"""Share of the patience that it may take."""


def combined_in_forces(found: ForceAttribution, settings: Settings) -> tuple[Combination, ...]:
    """Of the missing forces, by their derivatives."""
    scene, hypothesis = found.data.scene, found.hypothesis
    if not hypothesis.effects:
        return ()
    try:
        wide = widened(scene, found.samples, hypothesis, settings.effects)
        slopes = jacobian(found, wide.whole)
    except OrbiSimError:
        return ()
    return _combined(scene, wide, found.fit, slopes.T @ slopes, settings.seed)


def _combined(
    scene: Scene, wide: Wide, fit: Fit, gram: Floats, seed: int, independent: float = np.inf
) -> tuple[Combination, ...]:
    """What is determined of numbers that are not, by the information of all of them.

    Args:
      fit: of what was found. gram: [N, N]. independent: data of the fit.
    """
    names = [str(k) for k in range(len(fit.values))]
    intervals = confidence(fit, names, seed, independent)
    half = np.array([np.ptp(intervals[name]) / 2 for name in names])
    found, keys, own = *wide.ties(scene, fit, gram, half), len(names)
    both = tied(fit, found, own)
    intervals = confidence(both, names, seed, independent)
    result = []
    for one in found:
        parts = {one.first: 1.0, **one.others}
        at = [(wide.whole.effects[keys[k][0]], keys[k][1], b) for k, b in parts.items()]
        terms = tuple(Term(effect.effect, effect.target, name, b) for effect, name, b in at)
        none = sum(b * wide.neutral[keys[k]] for k, b in one.others.items() if k >= own)
        value, *ends = (x + none for x in (both.values[one.first], *intervals[names[one.first]]))
        units = find(at[0][0].effect).units(scene.model, at[0][0])
        unit = units.get(at[0][1], next(iter(units.values())))
        told = together(terms, value, (ends[0], ends[1]), unit)
        result.append(Combination(terms, float(value), unit, (ends[0], ends[1]), told))
    return tuple(result)
