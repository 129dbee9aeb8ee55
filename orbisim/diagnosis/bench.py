"""The data of a diagnosis, and how well a scene with some effects explains them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.linear import IntervalMap, Intervals, linearize
from orbisim.diagnosis.noise import estimate_noise
from orbisim.diagnosis.regress import Windows, cut_windows
from orbisim.diagnosis.samples import Samples
from orbisim.diagnosis.shooting import Shooter, Unknown
from orbisim.effects import EffectInstance, add_effects, find
from orbisim.errors import InputError
from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Noise = tuple[Floats, Floats]


@dataclasses.dataclass(frozen=True, eq=False)
class Bench:
    """A scene as declared, and windows of recordings to explain.

    Attributes:
      scene: as declared. samples: the recordings.
      rows: for each recording the rows at which usable intervals start.
      intervals: of the declared scene. windows: all windows.
      fit, check: which windows parameters are fitted to, and which choices are checked on.
      noise: standard deviations of positions and velocities.
    """

    scene: Scene
    samples: tuple[Samples, ...]
    rows: tuple[npt.NDArray[np.int64], ...]
    intervals: Intervals
    windows: Windows
    fit: Bools
    check: Bools
    noise: Noise

    def shooter(self, keep: Bools) -> Shooter:
        """Simulates the chosen windows."""
        return Shooter(
            self.scene, self.samples, self.intervals, self.windows.some(keep), self.noise
        )

    def flow(self, variant: Scene | None = None) -> IntervalMap:
        """The map of a variant over all sampling intervals."""
        return IntervalMap(self.scene, self.samples, self.rows, variant)

    def with_noise_of(self, variant: Scene) -> Bench:
        """The same bench with the noise estimated along a better scene."""
        intervals = linearize(self.flow(variant))
        return dataclasses.replace(
            self, noise=estimate_noise(self.samples, intervals, self.windows.some(self.fit))
        )


def make_bench(
    scene: Scene, samples: Sequence[Samples], window: float, check: float = 0.3
) -> Bench:
    """Cuts recordings into windows.

    Args:
      scene: as declared. samples: recordings that parameters and choices may see.
      window: duration of a window, s. check: share of the windows that choices are checked on.

    Raises:
      InputError: the recordings are too short for a window.
    """
    rows = [np.flatnonzero(s.usable[:-1] & s.usable[1:]) for s in samples]
    if not sum(len(r) for r in rows):
        raise InputError("no two consecutive samples are usable")
    flow = IntervalMap(scene, samples, rows)
    intervals = linearize(flow)
    step = float(np.median(flow.duration))
    length = int(np.clip(round(window / step), 4, 200))
    windows = cut_windows(intervals, length)
    while not len(windows) and length > 4:
        length = max(4, length // 2)
        windows = cut_windows(intervals, length)
    if not len(windows):
        raise InputError("the recordings are too short, or too full of gaps, for a single window")
    held = _last_windows(windows, len(samples), check)
    noise = estimate_noise(samples, intervals, windows.some(~held))
    return Bench(scene, tuple(samples), tuple(rows), intervals, windows, ~held, held, noise)


def _last_windows(windows: Windows, recordings: int, share: float) -> Bools:
    """The last windows of every recording, about the given share."""
    held = np.zeros(len(windows), bool)
    for i in range(recordings):
        own = np.flatnonzero(windows.recording == i)
        count = round(share * len(own))
        if count and count < len(own):
            held[own[-count:]] = True
    if not held.any() and len(windows) > 1:
        held[-1] = True
    return held


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """Effects that are added to the declared scene, with their values.

    Attributes:
      effects: the effects, in the order in which they were found.
      frozen: parameters that the data do not determine, (number of the effect, name): they keep
        their values.
    """

    effects: tuple[EffectInstance, ...] = ()
    frozen: frozenset[tuple[int, str]] = frozenset()

    def scene(self, declared: Scene) -> Scene:
        """The declared scene with the effects."""
        simulated = [e for e in self.effects if not find(e.effect).measurement]
        return add_effects(declared, simulated) if simulated else declared

    def plus(self, instance: EffectInstance) -> Hypothesis:
        """With one effect more."""
        return dataclasses.replace(self, effects=(*self.effects, instance))

    def without(self, index: int) -> Hypothesis:
        """With one effect less."""
        kept = tuple(e for i, e in enumerate(self.effects) if i != index)
        frozen = frozenset((i - (i > index), name) for i, name in self.frozen if i != index)
        return Hypothesis(kept, frozen)

    def free(self, declared: Scene) -> list[tuple[int, str]]:
        """What a fit changes: number of the effect and name of the parameter."""
        return [
            (i, name)
            for i, e in enumerate(self.effects)
            for name in find(e.effect).free_parameters(declared.model, e.target)
            if (i, name) not in self.frozen
        ]

    def values(self, declared: Scene) -> Floats:
        """The present values of the free parameters."""
        coded = [_free_values(declared, e) for e in self.effects]
        return np.array([coded[i][n] for i, n in self.free(declared)], np.float64)

    def at(self, declared: Scene, values: Floats) -> Hypothesis:
        """With other values of the free parameters."""
        changes: dict[int, dict[str, float]] = {}
        for (i, name), value in zip(self.free(declared), values, strict=True):
            changes.setdefault(i, {})[name] = float(value)
        effects = tuple(_with(declared, e, changes.get(i, {})) for i, e in enumerate(self.effects))
        return dataclasses.replace(self, effects=effects)

    def unknowns(self, declared: Scene) -> list[Unknown]:
        """The free parameters with bounds and difference steps."""
        model = declared.model
        found: list[Unknown] = []
        for i, name in self.free(declared):
            e = self.effects[i]
            effect = find(e.effect)
            known = {p.name: p for p in effect.parameters(model, e.target)}
            low, high, scale = -1e6, 1e6, 0.02
            if name in known:
                low, high, scale = known[name].low, known[name].high, known[name].scale
            value = float(_free_values(declared, e)[name])
            step = 1e-4 * max(abs(value), 0.05 * abs(scale), 1e-9)
            step = max(step, effect.resolution(model, name))
            found.append(Unknown(f"{e.effect}({e.target}).{name}", value, low, high, step))
        return found


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
