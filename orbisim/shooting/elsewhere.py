"""What would do the same as the effects of a hypothesis, at other places or by another effect."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection, Mapping, Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.effects import EffectInstance, effect_names, find
from orbisim.effects.base import Extent
from orbisim.errors import OrbiSimError
from orbisim.motion.samples import Samples, extent
from orbisim.scene import Scene
from orbisim.shooting.fits import Fit
from orbisim.shooting.hypothesis import Hypothesis, completed
from orbisim.shooting.ties import ALIKE, Tie, inverse_of, ties

Floats = npt.NDArray[np.float64]
Key = tuple[int, str]
"""Number of an effect and name of one of its numbers."""


@dataclasses.dataclass(frozen=True, eq=False)
class Wide:
    """A hypothesis, and the same with a little of what would do the same elsewhere.

    Attributes:
      found: what was found. extent: of the recordings.
      whole: with `_LITTLE` of each of the others after its effects.
      size: usual size of each number that is one, with its sign. neutral: where there is nothing.
      width: usual size of each number that says where or how something is.
    """

    found: Hypothesis
    extent: Extent
    whole: Hypothesis
    size: Mapping[Key, float]
    neutral: Mapping[Key, float]
    width: Mapping[Key, float]

    def _possible(self, scene: Scene, now: Floats, moved: Floats) -> bool:
        """Whether what was found can be so much less, and is no more: others take its place, and do
        not work against it."""
        values = now + moved
        for one, value in zip(self.found.unknowns(scene), values, strict=True):
            if not one.low <= value <= one.high:
                return False
        for key, old, new in zip(self.found.free(scene), now, values, strict=False):
            none = self.neutral.get(key)
            if none is not None and abs(new - none) > (1 + ALIKE) * abs(old - none):
                return False
        effects, model = self.found.at(scene, values).effects, scene.model
        return all(find(e.effect).log_prior(model, e, self.extent) > -np.inf for e in effects)

    def ties(
        self, scene: Scene, fit: Fit, gram: Floats, half: Floats
    ) -> tuple[list[Tie], list[Key]]:
        """What is determined of numbers that are not, and the numbers: those that were fitted, then
        the others.

        Args:
          fit: of what was found. gram: [N, N] information on the numbers of the whole.
          half: [P] half-widths of the 95 % intervals of what was fitted.
        """
        every, own, there = self.whole.free(scene), len(fit.values), len(self.found.effects)
        free = own - len(self.found.factors)  # declared parameters are the last numbers of a fit
        keys = [*every[:free], *[_NONE] * (own - free), *every[free:]]
        if not own or not np.isfinite(gram).all():
            return [], keys
        order = [*range(free), *range(len(every), len(gram)), *range(free, len(every))]
        # data count as much less as the reported intervals are wider than these data's alone
        gram = gram[np.ix_(order, order)]
        sure = np.sqrt(np.diag(inverse_of(gram[:own, :own])))
        wider = float(np.nanmedian(half / (1.96 * sure)))
        if not wider > 0:
            return [], keys
        # where something is shows as much as there is of it: half of it would be elsewhere
        little = [key in self.width and key[0] >= there for key in keys]
        shown = np.where(little, 0.5 / _LITTLE, 1.0) / wider
        prior = [1 / self.width[key] ** 2 if key in self.width else 0.0 for key in keys]
        size = np.array([self.size.get(key, 0.0) for key in keys])
        beside = {
            k: [n for n, other in enumerate(keys) if other[0] == keys[k][0] and not size[n]]
            for k in np.flatnonzero(size).tolist()
            if k >= own
        }
        gram = gram * np.outer(shown, shown) + np.diag(prior)
        possible = functools.partial(self._possible, scene, fit.values)
        return ties(gram, size, own, beside, possible), keys


_NONE = (-1, "")
"""Of a declared parameter: of no effect."""
_LITTLE = 1e-3
"""Share of each that is added: no motion changes by it, and there are derivatives by it."""


def widened(
    scene: Scene, samples: Sequence[Samples], found: Hypothesis, only: Collection[str] | None
) -> Wide:
    """With all that is possible elsewhere; `only` these effects, or all if None."""
    effects, known = list(found.effects), extent(samples)
    places = {(e.effect, e.target) for e in effects}
    places |= {(find(e.effect).refines, e.target) for e in effects}
    for other in _elsewhere(scene, samples, found, known):
        place, effect = (other.effect, other.target), find(other.effect)
        if place in places or (only is not None and other.effect not in only):
            continue
        effects.append(other)
        places.add(place)
    size, neutral, width = dict[Key, float](), dict[Key, float](), dict[Key, float]()
    for i, one in enumerate(effects):
        effect = find(one.effect)
        known_as = {p.name: p for p in effect.parameters(scene.model, one.target)}
        free, sizes = dict(effect.encode(scene.model, one.target, one.values)), _sizes(scene, one)
        for name in free:
            if name in sizes:
                size[i, name], neutral[i, name] = sizes[name]
            else:
                width[i, name] = (known_as[name].scale if name in known_as else 0.0) or 1.0
        if i >= len(found.effects):
            free |= {n: at + _LITTLE * (free[n] - at) for n, (_, at) in sizes.items()}
            effects[i] = completed(scene, one, free)
    whole = dataclasses.replace(found, effects=tuple(effects))
    return Wide(found, known, whole, size, neutral, width)


def _sizes(scene: Scene, one: EffectInstance) -> dict[str, tuple[float, float]]:
    """Those numbers that say how much there is of an effect: the usual size, with its sign (where
    none is stated, what there is), and where there is nothing."""
    effect, model = find(one.effect), scene.model
    known = {p.name: p for p in effect.parameters(model, one.target)}
    free = effect.encode(model, one.target, one.values)
    found = {}
    for name in effect.sizes(model, one.target):
        parameter = known.get(name)
        at, usual = (parameter.neutral, parameter.usual) if parameter else (0.0, 0.0)
        if free[name] != at and not (parameter and at < parameter.low):
            found[name] = float(np.copysign(usual or free[name] - at, free[name] - at)), at
    return found


def _elsewhere(
    scene: Scene, samples: Sequence[Samples], found: Hypothesis, known: Extent
) -> list[EffectInstance]:
    """What would do the same as effects do at other places, or as another effect; that is possible
    and has derivatives."""
    model = scene.model
    data, rows = mujoco.MjData(model), np.flatnonzero(samples[0].usable)
    data.qpos[:] = samples[0].qpos[rows[len(rows) // 2]]
    mujoco.mj_kinematics(model, data)
    every = list[EffectInstance]()
    for one in found.effects:
        every += find(one.effect).elsewhere(model, one, data)
        every += find(one.effect).equivalents(model, one)
        for name in effect_names():
            more = find(name).generalized(model, one)[:1]
            every += [EffectInstance(name, one.target, dict(values)) for values in more]
    kept = []
    for other in every:
        effect = find(other.effect)
        try:
            effect.check(model, other)
        except OrbiSimError:
            continue
        likely = effect.log_prior(model, other, known) > -np.inf
        if likely and not (effect.stated or effect.structural) and _sizes(scene, other):
            kept.append(other)
    return kept
