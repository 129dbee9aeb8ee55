"""The data of a diagnosis, and how well a scene with some effects explains them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.fits import Unknown
from orbisim.diagnosis.noise import estimate_noise
from orbisim.diagnosis.retune import REACH, SPREAD, Tunable, retuned
from orbisim.diagnosis.shooting import Shooter, Variant
from orbisim.diagnosis.windows import Windows, cut_windows, runs_of
from orbisim.effects import EffectInstance, add_effects, find
from orbisim.effects.measurement import Measurement, measurement_of
from orbisim.errors import InputError
from orbisim.host.deadline import NEVER, Deadline
from orbisim.motion.linear import IntervalMap, Intervals, linearize
from orbisim.motion.samples import Samples
from orbisim.recording import Recording, bind
from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int64]
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
      deadline: when simulation ends with `TimeIsUpError`.
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
    deadline: Deadline = NEVER

    def shooter(self, keep: Bools) -> Shooter:
        """Simulates the chosen windows."""
        return Shooter(
            self.scene, self.samples, self.intervals, self.windows.some(keep), self.noise,
            self.deadline,
        )  # fmt: skip

    def flow(self, hypothesis: Hypothesis) -> IntervalMap:
        """The map of a hypothesis over all sampling intervals."""
        clock = hypothesis.measurement(self.scene).clock
        scene = hypothesis.scene(self.scene)
        return IntervalMap(self.scene, self.samples, self.rows, scene, clock, self.deadline)

    def known_signal(self, hypothesis: Hypothesis) -> list[Floats]:
        """What the measurement effects of a hypothesis add to each recording, [T, 2 nv]."""
        measurement = hypothesis.measurement(self.scene)
        found = []
        for one in self.samples:
            still = np.zeros((1, *one.absolute.shape))
            found.append(measurement.of(one.absolute[None], still, one.time[None])[0])
        return found

    def whole(self, noise: Noise | None = None) -> Bench:
        """All windows are fitted and checked; with another noise, if one is given."""
        every = np.ones(len(self.windows), bool)
        return dataclasses.replace(self, noise=noise or self.noise, fit=every, check=every)

    def with_noise_of(self, hypothesis: Hypothesis, intervals: Intervals) -> Bench:
        """The same bench with the noise estimated along a better scene."""
        found = estimate_noise(
            self.samples, intervals, self.windows.some(self.fit), self.known_signal(hypothesis)
        )
        return dataclasses.replace(self, noise=_lower(found, self.samples))


def _lower(found: Noise, samples: Sequence[Samples]) -> Noise:
    """The lower of two estimates, both of which take unknown motion for noise; not below what
    rounding to the sensors' steps leaves, which repeats itself where motion is slow."""
    one, nv = samples[0], len(found[0])
    q, v = np.fmin(found[0], one.q_noise), np.fmin(found[1], one.v_noise)
    return np.maximum(q, one.rounding[:nv]), np.maximum(v, one.rounding[nv:])


def make_bench(
    scene: Scene,
    samples: Sequence[Samples],
    window: float,
    check: float = 0.3,
    noise: Noise | None = None,
) -> Bench:
    """Cuts recordings into windows.

    Args:
      scene: as declared. samples: recordings that parameters and choices may see.
      window: duration of a window, s. check: share of the windows that choices are checked on.
      noise: standard deviations of positions and velocities, where they are known already.

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
        raise InputError(_TOO_SHORT)
    if contacts:
        first = noise or _lower(estimate_noise(samples, intervals, windows), samples)
        windows = _without_lost(
            _predictable(scene, samples, intervals, first, windows.length), intervals
        )
    held = _every_third(windows, len(samples), check)
    noise = noise or _lower(estimate_noise(samples, intervals, windows.some(~held)), samples)
    return Bench(
        scene, tuple(samples), tuple(kept), intervals, windows, ~held, held, noise, contacts
    )


_TOO_SHORT = (
    "no stretch of the recordings is as long as a window; record longer, without gaps, or choose "
    "a shorter window"
)


def touches(scene: Scene, samples: Sequence[Samples]) -> bool:
    """Whether bodies touch somewhere along the recordings."""
    return any(_touch(scene, one.qpos[one.usable]) for one in samples)


def _touch(scene: Scene, qpos: Floats) -> bool:
    """Whether bodies touch at some of the positions [T, nq]."""
    model, data = scene.model, mujoco.MjData(scene.model)
    for row in qpos[:: max(1, len(qpos) // 200)]:
        data.qpos[:] = row
        mujoco.mj_fwdPosition(model, data)
        if data.ncon:
            return True
    return False


def windows_enough(scene: Scene, recordings: Sequence[Recording], window: float) -> int:
    """How many windows of so many s recordings should hold: as many as a search looks at, and half
    as many again, to choose from; fewer where bodies touch."""
    some = [bind(recordings[i], scene).qpos for i in range(0, len(recordings), _LOOKED_AT)]
    positions = np.concatenate(some)
    if not _touch(scene, positions[np.isfinite(positions).all(axis=1)]):
        return _WINDOWS
    step = float(np.median(np.diff(recordings[0].time)))
    budget = _budget(scene, True) or 0
    return min(_WINDOWS, int(np.ceil(1.5 * budget * step / window)))


_LOOKED_AT = 8
_WINDOWS = 144
"""Two thirds of them are fitted, 96 at most."""


def _budget(scene: Scene, contacts: bool) -> int | None:
    """How many intervals are taken: steps with contacts are slow, and there are 3 nv for each."""
    return max(600, _CONTACT_STEPS // (3 * scene.model.nv)) if contacts else None


_CONTACT_STEPS = 27_000


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
    length = _fitting(recording, row, length)
    windows = cut_windows(recording, row, length, near)
    while not len(windows) and length > 4:
        length = max(4, length // 2)
        windows = cut_windows(recording, row, length, near)
    if budget is not None and len(windows) * windows.length > budget:
        keep = np.zeros(len(windows), bool)
        count = max(3, budget // (2 * windows.length))
        last = len(windows) - 1
        pairs = np.unique(np.linspace(0, max(last - 1, 0), count).round().astype(int))
        keep[pairs] = keep[np.minimum(pairs + 1, last)] = True
        windows = windows.some(keep)
        inside = np.zeros(len(row), bool)
        for first in windows.first:
            inside[first : first + windows.length] = True
        number = np.cumsum(inside) - 1
        windows = Windows(number[windows.first], windows.length, windows.recording)
        recording, row = recording[inside], row[inside]
    return windows, [row[recording == i] for i in range(len(rows))]


def _fitting(recording: Ints, row: Ints, length: int) -> int:
    """A length of windows, at most a third shorter, that leaves little of short runs unused."""
    runs = np.array([stop - start for start, stop in runs_of(recording, row)])
    choices = range(length, max(4, 2 * length // 3) - 1, -1)
    return max(choices, key=lambda k: (round(float((runs // k * k).sum()) / runs.sum(), 2), k))


def _near_jump(one: Samples) -> Bools:
    """[T]: whether an impact is so close that the reference is not to be trusted as a start."""
    jump = np.append(one.jumps.any(axis=1), False)
    near = jump.copy()
    for shift in range(1, _JUMP_REACH + 1):
        near[shift:] |= jump[:-shift]
        near[:-shift] |= jump[shift:]
    return near


_JUMP_REACH = 3


def _predictable(
    scene: Scene, samples: Sequence[Samples], intervals: Intervals, noise: Noise, length: int
) -> Windows:
    """Windows in which something can be predicted, with their horizons.

    In the middle of impacts, what the noise leaves unknown of a start decides everything. Of
    windows that start everywhere, those are taken that do not overlap and have most to predict.
    """
    step = max(1, length // 4)
    first: list[int] = []
    run: list[int] = []
    for number, (start, stop) in enumerate(runs_of(intervals.recording, intervals.row)):
        places = np.unique([*range(start, stop - length + 1, step), stop - length])
        places = places[places >= start]
        first += list(places)
        run += [number] * len(places)
    if not first:
        raise InputError(_TOO_SHORT)
    every = Windows(np.array(first), length, intervals.recording[first])
    shooter = Shooter(scene, samples, intervals, every, noise)
    every = dataclasses.replace(every, horizon=_horizons(shooter, noise))
    every = wrongly_lost(shooter, every, noise)
    worth = _worth(shooter, every, noise)
    telling = every.reach() >= max(4, length // 3)
    if telling.sum() >= _FEW:
        every, worth = every.some(telling), worth[telling]
        run = list(np.array(run)[telling])
    return every.some(_apart(every, np.array(run), worth))


_FEW = 4


def _worth(shooter: Shooter, windows: Windows, noise: Noise) -> Floats:
    """[W]: how much moves, beyond the noise, in what can be predicted of each window."""
    sigma = np.where(np.isfinite(noise[0]), noise[0], np.inf)
    inside = windows.predictable()[:, :, : shooter.nv]
    worth = np.zeros(len(shooter))
    for k in range(windows.length):
        change = np.abs(shooter.difference(shooter.qpos[:, k], shooter.qpos[:, k + 1])) / sigma
        worth += np.where(inside[:, k + 1], 0.1 + np.log1p(change), 0.0).max(axis=1)
    return worth


def _apart(windows: Windows, run: Ints, worth: Floats) -> Bools:
    """Windows that do not overlap and are worth most, by dynamic programming."""
    order = np.lexsort((windows.first, run))
    first, reach = windows.first[order], windows.reach()[order]
    best = np.zeros(len(order) + 1)
    taken = np.zeros(len(order), bool)
    before = np.zeros(len(order), int)
    for i in range(len(order)):
        free = (run[order[:i]] != run[order[i]]) | (first[:i] + reach[:i] <= first[i])
        before[i] = 0 if not free.any() else int(np.flatnonzero(free)[-1]) + 1
        with_it = best[before[i]] + worth[order[i]]
        taken[i] = with_it > best[i]
        best[i + 1] = max(with_it, best[i])
    keep = np.zeros(len(order), bool)
    i = len(order)
    while i > 0:
        if taken[i - 1]:
            keep[order[i - 1]] = True
            i = before[i - 1]
        else:
            i -= 1
    return keep


def _horizons(shooter: Shooter, noise: Noise) -> Ints:
    """[W, 2 nv]: samples until what the noise leaves unknown of the start has grown so much,
    through impacts, that nothing can be said: runs from starts that differ by the noise part."""
    measured, nv = np.isfinite(np.concatenate(noise)), len(noise[0])
    size = start_size(noise, float(np.median(np.diff(shooter.time, axis=1))))
    rng = np.random.default_rng(0)
    variant, still = Variant(shooter.declared), np.zeros((len(shooter), 2 * nv))
    base = shooter.simulate(variant, still)
    growth, bend = np.zeros(shooter.shape), np.zeros(shooter.shape)
    for _ in range(_PROBES):
        start = _KNOWN * size * rng.standard_normal(still.shape)
        one, other = ((shooter.simulate(variant, s) - base) / size for s in (start, -start))
        growth += np.nan_to_num(one - other, nan=np.inf) ** 2 / (4 * _PROBES)
        bend += np.nan_to_num(one + other, nan=np.inf) ** 2 / (4 * _PROBES)
    lost = (growth > _GROWTH**2) | (bend > _BEND**2)
    horizon = np.where(lost.any(axis=1), lost.argmax(axis=1) - 1, shooter.windows.length)
    return np.where(measured, np.maximum(horizon, _SURE), 0)


def wrongly_lost(shooter: Shooter, windows: Windows, noise: Noise) -> Windows:
    """With whole windows where most would end early, and data are far from all that the scene says:
    the impacts that make it unpredictable may never have happened."""
    short = windows.reach() < windows.length
    if short.mean() <= _MOST_SHORT or windows.horizon is None:
        return windows
    still = np.zeros((len(shooter), 2 * shooter.nv))
    apart = np.abs(shooter.residual(shooter.simulate(Variant(shooter.declared), still)))
    far = short & (apart.max(axis=1) > _APART)
    if not far[short].mean() > _MOST_SHORT:
        return windows
    measured = np.isfinite(np.concatenate(noise))
    whole = np.where(measured, windows.length, 0)
    return dataclasses.replace(windows, horizon=np.where(far[:, None], whole, windows.horizon))


_MOST_SHORT = 0.5
_APART = 100.0
"""In units of the noise."""


def start_size(noise: Noise, step: float) -> Floats:
    """[2 nv]: what the noise leaves unknown of a window's start; velocities that are not measured
    by differences of positions.

    Args:
      step: typical time between samples, s.
    """
    sigma = np.concatenate(noise)
    from_positions = np.concatenate([noise[0], noise[0] / (4 * step)])
    size = np.where(np.isfinite(sigma), sigma, from_positions)
    return np.where(np.isfinite(size), size, np.nanmax(size))


_PROBES = 3
_GROWTH = 60.0
_BEND = 1.0
_KNOWN = 0.5
_SURE = 1


def _without_lost(windows: Windows, intervals: Intervals) -> Windows:
    """Windows all of whose intervals could be simulated."""
    lost = np.append(0, np.cumsum(~intervals.usable))
    return windows.some(lost[windows.first + windows.length] == lost[windows.first])


def _every_third(windows: Windows, recordings: int, share: float) -> Bools:
    """Windows spread over recordings and over their durations, about the given share: rare events
    are seen by both."""
    held, every = np.zeros(len(windows), bool), round(1 / share)
    for i in range(recordings):
        own = np.flatnonzero(windows.recording == i)
        held[own[(every - 1 - i) % every :: every]] = True
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
        same = find(instance.effect).declared_as
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
        taken = {(find(e.effect).declared_as, e.target) for e in self.effects}
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
            if effect.stepwise(e, name):
                step = max(step, _COARSE * abs(value))
            found.append(Unknown(f"{e.effect}({e.target}).{name}", value, low, high, step))
        found += [
            Unknown(str(one), factor, 1 - REACH, 1 + REACH, 1e-4, 1.0, 1 / SPREAD**2)
            for one, factor in self.factors
        ]
        return found


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
