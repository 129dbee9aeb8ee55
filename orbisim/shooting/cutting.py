"""How recordings become windows: evenly and, where bodies touch, as far as anything can be told."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError
from orbisim.motion.linear import Intervals
from orbisim.motion.samples import Samples
from orbisim.recording import Recording, bind
from orbisim.scene import Scene
from orbisim.shooting.impacts import foreseen, near_jump
from orbisim.shooting.shooter import Shooter, Variant
from orbisim.shooting.windows import Windows, cut_windows, runs_of

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int64]
Noise = tuple[Floats, Floats]

TOO_SHORT = (
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
    budget = most_intervals(scene, True) or 0
    return min(_WINDOWS, int(np.ceil(1.5 * budget * step / window)))


_LOOKED_AT = 8
"""One recording of so many is looked at for contacts: there may be hundreds."""
_WINDOWS = 144
"""Two thirds of them are fitted, 96 at most."""


def most_intervals(scene: Scene, contacts: bool) -> int | None:
    """How many intervals are taken: steps with contacts are slow, and there are 3 nv for each."""
    return max(600, _CONTACT_STEPS // (3 * scene.model.nv)) if contacts else None


_CONTACT_STEPS = 27_000
"""Runs over single intervals, three for each degree of freedom in each: some seconds."""


def spread_windows(
    samples: Sequence[Samples],
    rows: Sequence[npt.NDArray[np.int64]],
    length: int,
    budget: int | None,
) -> tuple[Windows, list[npt.NDArray[np.int64]]]:
    """Windows, and for each recording the rows of their intervals; windows spread evenly."""
    recording = np.concatenate([np.full(len(r), i) for i, r in enumerate(rows)])
    row = np.concatenate([np.asarray(r) for r in rows]).astype(np.int64)
    near = np.concatenate([near_jump(samples[i])[r] for i, r in enumerate(rows)])
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


def predictable_windows(
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
        raise InputError(TOO_SHORT)
    every = Windows(np.array(first), length, intervals.recording[first])
    shooter = Shooter(scene, samples, intervals, every, noise)
    every = foreseen(shooter, intervals, every, noise)
    every = wrongly_lost(shooter, every, noise)
    worth = _worth(shooter, every, noise)
    telling = every.reach() >= max(4, length // 3)
    if telling.sum() >= _FEW:
        every, worth = every.some(telling), worth[telling]
        run = list(np.array(run)[telling])
    return every.some(_apart(every, np.array(run), worth))


_FEW = 4
"""Windows with much to predict that are enough to do without the others."""


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
    horizon = np.where(far[:, None], whole, windows.horizon)
    scatter = windows.scatter
    if scatter is not None:
        scatter = np.where(far[:, None, None], 0.0, scatter)
    return dataclasses.replace(windows, horizon=horizon, scatter=scatter)


_MOST_SHORT = 0.5
"""Share of the windows that is most of them."""
_APART = 100.0
"""In units of the noise."""


def without_lost(windows: Windows, intervals: Intervals) -> Windows:
    """Windows all of whose intervals could be simulated."""
    lost = np.append(0, np.cumsum(~intervals.usable))
    return windows.some(lost[windows.first + windows.length] == lost[windows.first])


def every_third(windows: Windows, recordings: int, share: float) -> Bools:
    """Windows spread over recordings and over their durations, about the given share: rare events
    are seen by both."""
    held, every = np.zeros(len(windows), bool), round(1 / share)
    for i in range(recordings):
        own = np.flatnonzero(windows.recording == i)
        held[own[(every - 1 - i) % every :: every]] = True
    if not held.any() and len(windows) > 1:
        held[-1] = True
    return held
