"""Recordings in other steps: how a scene is stepped, as a form of the data."""

from __future__ import annotations

import dataclasses
from typing import Any

import mujoco
import numpy as np

from orbisim.motion.samples import substeps
from orbisim.recording.initial import stagger
from orbisim.shooting.bench import Bench
from orbisim.shooting.stepping import stepping, with_stepping


def typical_interval(bench: Bench) -> float:
    """Between samples, s."""
    return float(np.median(np.concatenate([np.diff(one.time) for one in bench.samples])))


def taken(bench: Bench, timestep: float | None = None) -> float:
    """The step that a timestep means (the scene's if None), s: a typical sampling interval has a
    whole number of them."""
    timestep = float(bench.scene.model.opt.timestep) if timestep is None else timestep
    interval = typical_interval(bench)
    return interval / int(substeps(interval, timestep))


def stepped(bench: Bench, timestep: float, **other: Any) -> Bench:
    """With another timestep, and what else is given of how it is stepped (`Stepping`), and controls
    that are looked for between samples where they do the same."""
    changed = stepping(bench.scene)._replace(timestep=timestep, **other)
    there = dataclasses.replace(bench, scene=with_stepping(bench.scene, changed))
    if not bench.lead:
        return there
    later = (_early(bench) - _early(there)) / typical_interval(bench)
    share = float(np.clip(bench.lead.share + later, -1.0, 1.0))
    return there.led(dataclasses.replace(bench.lead, share=share))


def exact(bench: Bench, count: int) -> Bench:
    """With the classical Runge-Kutta method, whose error falls as the fourth power of the step, in
    so many steps between samples."""
    return stepped(bench, typical_interval(bench) / count, integrator=_RK4)


def is_exact(bench: Bench) -> bool:
    """Whether it has the steps of `exact`."""
    return stepping(bench.scene).integrator == _RK4


def held(bench: Bench, timestep: float) -> Bench:
    """In steps over which forces are held, a whole number in a sampling interval: by MuJoCo's
    implicitfast integrator in the place of exact steps, else by the one that there is."""
    interval, known = typical_interval(bench), stepping(bench.scene).integrator
    integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST) if is_exact(bench) else known
    count = max(round(interval / timestep), 1)
    return stepped(bench, interval / count, integrator=integrator)


def lengths(bench: Bench) -> tuple[float, ...]:
    """Of steps over which forces may be held, the first to be tried, s: a sixteenth and an eighth
    of a sampling interval instead of exact ones, else one step more in an interval and one less."""
    interval = typical_interval(bench)
    now = round(interval / taken(bench))
    counts = (16, 8) if is_exact(bench) else (now + 1, now - 1)
    return tuple(interval / count for count in counts if count)


def _early(bench: Bench) -> float:
    """By how much a force acts too early, s: MuJoCo's Euler and implicit integrators move a body by
    the velocity that a step ends with."""
    return stagger(bench.scene.model) * taken(bench)


_RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)


def peak(gains: dict[float, float], low: float, high: float) -> float | None:
    """Where what is left is least by the parabola through the best place and its neighbours, within
    bounds; None where that has no lowest point. In a model that is linear in its controls what is
    left, as a mean square, is a parabola in their share.

    Args:
      gains: by places along a line, as logarithms of what is left, negative.
    """
    known = sorted(place for place, value in gains.items() if np.isfinite(value))
    best = known.index(max(known, key=lambda place: gains[place]))
    first = min(max(best - 1, 0), len(known) - 3)
    if first < 0:
        return None
    near = known[first : first + 3]
    left = np.exp([-gains[place] for place in near])
    square, slope, _ = np.polyfit(np.array(near) / high, left, 2)
    return float(np.clip(-slope / (2 * square) * high, low, high)) if square > 0 else None
