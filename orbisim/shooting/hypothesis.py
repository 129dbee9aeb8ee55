"""Effects that are added to a declared scene, with what a fit changes of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.effects import EffectInstance, add_effects, find
from orbisim.effects.measurement import Measurement, measurement_of
from orbisim.errors import OrbiSimError
from orbisim.scene import Scene
from orbisim.shooting.fits import Unknown
from orbisim.shooting.retune import REACH, SPREAD, Tunable, retuned
from orbisim.shooting.shooter import Variant

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """Effects that are added to the declared scene, with their values.

    Attributes:
      effects: the effects, in the order in which they were found.
      frozen: parameters that the data do not determine, (number of the effect, name): they keep
        their values.
      factors: declared parameters that are retuned, with their factors; none if empty.
    """

    effects: tuple[EffectInstance, ...] = ()
    frozen: frozenset[tuple[int, str]] = frozenset()
    factors: tuple[tuple[Tunable, float], ...] = ()

    def scene(self, declared: Scene) -> Scene:
        """The declared scene with the effects that act on the simulation."""
        simulated = [e for e in self.effects if not find(e.effect).measurement]
        scene = retuned(declared, dict(self.factors))
        return add_effects(scene, simulated) if simulated else scene

    def measurement(self, declared: Scene) -> Measurement:
        """How the effects on the measurement change what is read."""
        return measurement_of(declared.model, self.effects)

    def variant(self, declared: Scene) -> Variant:
        """What is simulated and how it is measured."""
        return Variant(self.scene(declared), self.measurement(declared))

    def plus(self, instance: EffectInstance) -> Hypothesis:
        """With one effect more; a factor that means the same is dropped."""
        same, refined = find(instance.effect).declared_as, find(instance.effect).refines
        if (refined, instance.target) in {(e.effect, e.target) for e in self.effects}:
            instance = find(instance.effect).parts(instance)[0]
        kept = tuple(
            (one, factor)
            for one, factor in self.factors
            if (one.kind, one.target) != (same, instance.target)
        )
        return dataclasses.replace(self, effects=(*self.effects, instance), factors=kept)

    def rubs(self, declared: Scene) -> bool:
        """Whether there is dry friction at joints, declared or of an effect."""
        own = (find(one.effect).needs for one in self.effects)
        flag = mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
        return bool(declared.model.dof_frictionloss.any()) or any(flag in needs for needs in own)

    def little(self, declared: Scene, other: Hypothesis) -> Hypothesis | None:
        """With next to nothing of the effects that another one does not have; None if there are
        none, or if that cannot be."""
        there = {(one.effect, one.target) for one in other.effects}
        fewer = [
            one if (one.effect, one.target) in there else sized(declared, one, _LITTLE)
            for one in self.effects
        ]
        effects = tuple(one for one in fewer if one is not None)
        if len(effects) < len(self.effects) or effects == self.effects:
            return None
        return dataclasses.replace(self, effects=effects)

    def in_parts(self) -> Hypothesis:
        """With the simpler effects that others refine beside these, instead of within them."""
        effects: dict[tuple[str, str], EffectInstance] = {}
        for one in self.effects:
            for part in find(one.effect).parts(one):
                place, known = (part.effect, part.target), dict[str, float]()
                if place in effects:  # what both say of the simpler effect adds up
                    known = dict(effects[place].values)
                both = {name: value + known.get(name, 0.0) for name, value in part.values.items()}
                effects[place] = part.replace(**both)
        return dataclasses.replace(self, effects=tuple(effects.values()), frozen=frozenset())

    def without(self, index: int) -> Hypothesis:
        """With one effect less."""
        kept = tuple(e for i, e in enumerate(self.effects) if i != index)
        frozen = frozenset((i - (i > index), name) for i, name in self.frozen if i != index)
        return dataclasses.replace(self, effects=kept, frozen=frozen)

    def tuned(self, chosen: Iterable[Tunable]) -> Hypothesis:
        """With these declared parameters free."""
        taken = {(find(e.effect).declared_as, e.target) for e in self.effects}
        known = dict(self.factors)
        factors = tuple(
            (one, known.get(one, 1.0)) for one in chosen if (one.kind, one.target) not in taken
        )
        return dataclasses.replace(self, factors=factors)

    def free(self, declared: Scene) -> list[tuple[int, str]]:
        """What a fit changes of the effects: number of the effect and name of the parameter."""
        there = {(e.effect, e.target) for e in self.effects}
        return [
            (i, name)
            for i, e in enumerate(self.effects)
            for name in find(e.effect).free_parameters(declared.model, e.target)
            if (i, name) not in self.frozen
            and not (name in find(e.effect).shared and (find(e.effect).refines, e.target) in there)
        ]

    def sizes(self, declared: Scene, number: int) -> tuple[list[int], list[float]]:
        """Which of the fitted numbers say how much there is of an effect, and where that is
        nothing; none of what no derivative says anything of."""
        model, instance = declared.model, self.effects[number]
        effect, free = find(instance.effect), self.free(declared)
        if effect.stated or effect.structural:
            return [], []
        names = effect.sizes(model, instance.target)
        own = [k for k, (i, name) in enumerate(free) if i == number and name in names]
        neutral = effect.neutral(model, instance.target)
        return own, [neutral.get(free[k][1], 0.0) for k in own]

    def values(self, declared: Scene) -> Floats:
        """The present values of the free parameters, then of the factors."""
        coded = [_free_values(declared, e) for e in self.effects]
        own = [coded[i][n] for i, n in self.free(declared)]
        return np.array([*own, *(factor for _, factor in self.factors)], np.float64)

    def at(self, declared: Scene, values: Floats) -> Hypothesis:
        """With other values of the free parameters and factors."""
        changes: dict[int, dict[str, float]] = {}
        free = self.free(declared)
        for (i, name), value in zip(free, values, strict=False):
            changes.setdefault(i, {})[name] = float(value)
        effects = tuple(_with(declared, e, changes.get(i, {})) for i, e in enumerate(self.effects))
        factors = tuple(
            (one, float(value))
            for (one, _), value in zip(self.factors, values[len(free) :], strict=True)
        )
        return dataclasses.replace(self, effects=effects, factors=factors)

    def unknowns(self, declared: Scene) -> list[Unknown]:
        """The free parameters and factors with bounds, priors and difference steps."""
        model = declared.model
        found: list[Unknown] = []
        for i, name in self.free(declared):
            e = self.effects[i]
            effect = find(e.effect)
            known = {p.name: p for p in effect.parameters(model, e.target)}
            low, high, scale = -1e6, 1e6, 0.02
            if name in known:
                one, scale = known[name], known[name].scale
                low, high = max(one.low, one.possible[0]), min(one.high, one.possible[1])
            value = float(_free_values(declared, e)[name])
            step = 1e-4 * max(abs(value), 0.05 * abs(scale), 1e-9)
            stepwise = effect.stepwise(e, name)
            if stepwise:
                step = max(step, _COARSE * abs(value))
            widest = max(step, min(abs(scale), (high - low) / 4))
            label = f"{e.effect}({e.target}).{name}"
            found.append(Unknown(label, value, low, high, step, widest=widest, stepwise=stepwise))
        found += [
            Unknown(str(one), factor, 1 - REACH, 1 + REACH, 1e-4, 1.0, 1 / SPREAD**2, REACH / 2)
            for one, factor in self.factors
        ]
        return found


_LITTLE = 0.01
"""Of an effect, that is next to nothing."""
_COARSE = 0.03
"""Relative step of differences by parameters that act in steps."""


def _with(
    declared: Scene, instance: EffectInstance, changes: Mapping[str, float]
) -> EffectInstance:
    if not changes:
        return instance
    free = {**_free_values(declared, instance), **changes}
    return completed(declared, instance, free)


def _free_values(declared: Scene, instance: EffectInstance) -> Mapping[str, float]:
    effect = find(instance.effect)
    return effect.encode(declared.model, instance.target, instance.values)


def completed(
    declared: Scene, instance: EffectInstance, free: Mapping[str, float]
) -> EffectInstance:
    """The effect with all its parameters from the free ones, within their bounds."""
    effect = find(instance.effect)
    full = {**instance.values, **effect.complete(declared.model, instance.target, free)}
    return clean(declared, dataclasses.replace(instance, values=full))


def clean(declared: Scene, instance: EffectInstance) -> EffectInstance:
    """Only the effect's own parameters, within their bounds."""
    values = {}
    for p in find(instance.effect).parameters(declared.model, instance.target):
        values[p.name] = float(np.clip(instance.values[p.name], p.low, p.high))
    return dataclasses.replace(instance, values=values)


def bounded_instance(scene: Scene, instance: EffectInstance) -> EffectInstance | None:
    """An effect with all parameters, within their bounds; None if it is not possible."""
    effect = find(instance.effect)
    names = effect.free_parameters(scene.model, instance.target)
    try:
        if all(name in instance.values for name in names):
            free = {name: instance.values[name] for name in names}
            instance = completed(scene, instance, free)
        else:
            instance = clean(scene, instance)
        effect.check(scene.model, instance)
    except (OrbiSimError, KeyError):
        return None
    return instance


def sized(scene: Scene, one: EffectInstance, size: float) -> EffectInstance | None:
    """An effect that changes so many times as much, within its bounds; None if that cannot be."""
    effect = find(one.effect)
    neutral = effect.neutral(scene.model, one.target)
    if not one.values.keys() >= set(effect.free_parameters(scene.model, one.target)):
        grows = effect.sizes(scene.model, one.target)
        free = _free_values(scene, one)
        more = {name: size * value if name in grows else value for name, value in free.items()}
        return completed(scene, one, more)
    away = {name: value - neutral.get(name, 0.0) for name, value in one.values.items()}
    further = effect.scaled(away, size)
    values = {name: value + neutral.get(name, 0.0) for name, value in further.items()}
    return bounded_instance(scene, dataclasses.replace(one, values=values))
