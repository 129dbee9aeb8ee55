"""The data of a diagnosis, and how well a scene with some effects explains them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.gauss_newton import Unknown
from orbisim.diagnosis.linear import IntervalMap, Intervals, linearize
from orbisim.diagnosis.measurement import Measurement, measurement_of
from orbisim.diagnosis.noise import estimate_noise
from orbisim.diagnosis.regress import Windows, cut_windows
from orbisim.diagnosis.retune import REACH, SPREAD, Tunable, retuned
from orbisim.diagnosis.samples import Samples
from orbisim.diagnosis.shooting import Shooter, Variant
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
      contacts: whether the motion has contacts, where derivatives hold only close by.
    """

    scene: Scene
    samples: tuple[Samples, ...]
    rows: tuple[npt.NDArray[np.int64], ...]
    intervals: Intervals
    windows: Windows
    fit: Bools
    check: Bools
    noise: Noise
    contacts: bool = False

    def shooter(self, keep: Bools) -> Shooter:
        """Simulates the chosen windows."""
        return Shooter(
            self.scene, self.samples, self.intervals, self.windows.some(keep), self.noise
        )

    def flow(self, hypothesis: Hypothesis) -> IntervalMap:
        """The map of a hypothesis over all sampling intervals."""
        clock = hypothesis.measurement(self.scene).clock
        return IntervalMap(self.scene, self.samples, self.rows, hypothesis.scene(self.scene), clock)

    def known_signal(self, hypothesis: Hypothesis) -> list[Floats]:
        """What the measurement effects of a hypothesis add to each recording, [T, 2 nv]."""
        measurement = hypothesis.measurement(self.scene)
        found = []
        for one in self.samples:
            still = np.zeros((1, *one.absolute.shape))
            found.append(measurement.of(one.absolute[None], still, one.time[None])[0])
        return found

    def with_noise_of(self, hypothesis: Hypothesis, intervals: Intervals) -> Bench:
        """The same bench with the noise estimated along a better scene."""
        found = estimate_noise(
            self.samples, intervals, self.windows.some(self.fit), self.known_signal(hypothesis)
        )
        return dataclasses.replace(self, noise=_lower(found, self.samples))


def _lower(found: Noise, samples: Sequence[Samples]) -> Noise:
    """The lower of two estimates, both of which take unknown motion for noise."""
    one = samples[0]
    return np.fmin(found[0], one.q_noise), np.fmin(found[1], one.v_noise)


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
    contacts = touches(scene, samples)
    step = float(np.median(np.concatenate([np.diff(s.time) for s in samples])))
    length = int(np.clip(round(window / step), 4, 200))
    windows, kept = _cut(samples, rows, length, _budget(scene, contacts))
    intervals = linearize(IntervalMap(scene, samples, kept))
    windows = _without_lost(windows, intervals)
    if not len(windows):
        raise InputError("the recordings are too short, or too full of gaps, for a single window")
    held = _every_third(windows, len(samples), check)
    found = estimate_noise(samples, intervals, windows.some(~held))
    noise = _lower(found, samples)
    if contacts:
        windows = _with_horizon(windows, intervals, noise, step)
    return Bench(
        scene, tuple(samples), tuple(kept), intervals, windows, ~held, held, noise, contacts
    )


def touches(scene: Scene, samples: Sequence[Samples]) -> bool:
    """Whether bodies touch somewhere along the recordings."""
    model, data = scene.model, mujoco.MjData(scene.model)
    for one in samples:
        rows = np.flatnonzero(one.usable)
        for row in rows[:: max(1, len(rows) // 200)]:
            data.qpos[:] = one.qpos[row]
            mujoco.mj_fwdPosition(model, data)
            if data.ncon:
                return True
    return False


def _budget(scene: Scene, contacts: bool) -> int | None:
    """How many intervals are taken: steps with contacts are slow, and there are 3 nv for each."""
    return max(600, _CONTACT_STEPS // (3 * scene.model.nv)) if contacts else None


_CONTACT_STEPS = 18_000


def _cut(
    samples: Sequence[Samples],
    rows: Sequence[npt.NDArray[np.int64]],
    length: int,
    budget: int | None,
) -> tuple[Windows, list[npt.NDArray[np.int64]]]:
    """Windows, and for each recording the rows of their intervals; windows spread evenly."""
    recording = np.concatenate([np.full(len(r), i) for i, r in enumerate(rows)])
    row = np.concatenate([np.asarray(r) for r in rows]).astype(np.int64)
    near = np.concatenate([_near_jump(samples[i])[r] for i, r in enumerate(rows)])
    windows = cut_windows(recording, row, length, near)
    while not len(windows) and length > 4:
        length = max(4, length // 2)
        windows = cut_windows(recording, row, length, near)
    if budget is not None and len(windows) * windows.length > budget:
        keep = np.zeros(len(windows), bool)
        count = max(6, budget // windows.length)
        keep[np.unique(np.linspace(0, len(windows) - 1, count).round().astype(int))] = True
        windows = windows.some(keep)
        inside = np.zeros(len(row), bool)
        for first in windows.first:
            inside[first : first + windows.length] = True
        number = np.cumsum(inside) - 1
        windows = Windows(number[windows.first], windows.length, windows.recording)
        recording, row = recording[inside], row[inside]
    return windows, [row[recording == i] for i in range(len(rows))]


def _near_jump(one: Samples) -> Bools:
    """[T]: whether an impact is so close that the reference is not to be trusted as a start."""
    jump = np.append(one.jumps.any(axis=1), False)
    near = jump.copy()
    for shift in range(1, _JUMP_REACH + 1):
        near[shift:] |= jump[:-shift]
        near[:-shift] |= jump[shift:]
    return near


_JUMP_REACH = 3


def _with_horizon(windows: Windows, intervals: Intervals, noise: Noise, step: float) -> Windows:
    """Ends windows where what the noise leaves unknown of the start has grown so much, through
    impacts, that nothing can be said."""
    sigma, nv = np.concatenate(noise), len(noise[0])
    measured = np.isfinite(sigma)
    fallback = np.concatenate([sigma[:nv], sigma[:nv] / (4 * step)])
    size = np.where(measured, sigma, fallback)
    size = np.where(np.isfinite(size), size, np.nanmax(size))
    x = np.tile(np.diag(size), (len(windows), 1, 1))
    horizon = np.full(len(windows), windows.length)
    for k in range(windows.length):
        x = np.einsum("wij,wjc->wic", intervals.A[windows.first + k], x)
        growth = (np.linalg.norm(x, axis=2) / size)[:, measured].max(axis=1)
        lost = np.nan_to_num(growth, nan=np.inf) > _GROWTH
        horizon = np.where(lost, np.minimum(horizon, k), horizon)
    return dataclasses.replace(windows, horizon=np.maximum(horizon, _SURE))


_GROWTH = 100.0
_SURE = 4


def _without_lost(windows: Windows, intervals: Intervals) -> Windows:
    """Windows all of whose intervals could be simulated."""
    lost = np.append(0, np.cumsum(~intervals.usable))
    return windows.some(lost[windows.first + windows.length] == lost[windows.first])


def _every_third(windows: Windows, recordings: int, share: float) -> Bools:
    """Windows spread over every recording, about the given share: rare events are seen by both."""
    held = np.zeros(len(windows), bool)
    for i in range(recordings):
        own = np.flatnonzero(windows.recording == i)
        held[own[round(1 / share) - 1 :: round(1 / share)]] = True
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
        same = SAME.get(instance.effect)
        kept = tuple(
            (one, factor)
            for one, factor in self.factors
            if (one.kind, one.target) != (same, instance.target)
        )
        return dataclasses.replace(self, effects=(*self.effects, instance), factors=kept)

    def without(self, index: int) -> Hypothesis:
        """With one effect less."""
        kept = tuple(e for i, e in enumerate(self.effects) if i != index)
        frozen = frozenset((i - (i > index), name) for i, name in self.frozen if i != index)
        return dataclasses.replace(self, effects=kept, frozen=frozen)

    def tuned(self, chosen: Iterable[Tunable]) -> Hypothesis:
        """With these declared parameters free."""
        taken = {(SAME.get(e.effect), e.target) for e in self.effects}
        known = dict(self.factors)
        factors = tuple(
            (one, known.get(one, 1.0)) for one in chosen if (one.kind, one.target) not in taken
        )
        return dataclasses.replace(self, factors=factors)

    def free(self, declared: Scene) -> list[tuple[int, str]]:
        """What a fit changes of the effects: number of the effect and name of the parameter."""
        return [
            (i, name)
            for i, e in enumerate(self.effects)
            for name in find(e.effect).free_parameters(declared.model, e.target)
            if (i, name) not in self.frozen
        ]

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
                low, high, scale = known[name].low, known[name].high, known[name].scale
            value = float(_free_values(declared, e)[name])
            step = 1e-4 * max(abs(value), 0.05 * abs(scale), 1e-9)
            step = max(step, effect.resolution(model, name))
            found.append(Unknown(f"{e.effect}({e.target}).{name}", value, low, high, step))
        found += [
            Unknown(str(one), factor, 1 - REACH, 1 + REACH, 1e-4, 1.0, 1 / SPREAD**2)
            for one, factor in self.factors
        ]
        return found


SAME = {
    "torque_gain": "gain",
    "viscous_damping": "damping",
    "coulomb_friction": "frictionloss",
    "armature": "armature",
    "joint_spring": "stiffness",
    "payload": "mass",
}
"""Declared parameters that an effect at the same target changes too."""


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
