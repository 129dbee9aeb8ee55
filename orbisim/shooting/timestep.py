"""The timestep and the integrator of a scene along recordings."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import mujoco
import numpy as np

from orbisim.motion.samples import substeps
from orbisim.scene import Scene
from orbisim.shooting.bench import Bench


class Stepping(NamedTuple):
    """How a scene is stepped: timestep in s, integrator as of `mujoco.mjtIntegrator`."""

    timestep: float
    integrator: int


def stepping(scene: Scene) -> Stepping:
    """How a scene is stepped."""
    return Stepping(float(scene.model.opt.timestep), int(scene.model.opt.integrator))


def typical_interval(bench: Bench) -> float:
    """Between samples, s."""
    return float(np.median(np.concatenate([np.diff(one.time) for one in bench.samples])))


def taken(bench: Bench, timestep: float | None = None) -> float:
    """The step that a timestep means (the scene's if None), s: a typical sampling interval has a
    whole number of them."""
    timestep = float(bench.scene.model.opt.timestep) if timestep is None else timestep
    interval = typical_interval(bench)
    return interval / int(substeps(interval, timestep))


def with_stepping(scene: Scene, other: Stepping) -> Scene:
    """The scene, stepped in another way."""
    spec = scene.spec
    spec.option.timestep, spec.option.integrator = other
    return Scene.from_spec(spec, source=scene.source, unsupported=scene.unsupported)


def stepped(bench: Bench, timestep: float, integrator: int | None = None) -> Bench:
    """With another timestep, and integrator if one is given, and controls that are looked for
    between samples where they do the same."""
    known = stepping(bench.scene)
    changed = Stepping(timestep, known.integrator if integrator is None else integrator)
    other = dataclasses.replace(bench, scene=with_stepping(bench.scene, changed))
    if not bench.lead:
        return other
    later = (_early(bench) - _early(other)) / typical_interval(bench)
    share = float(np.clip(bench.lead.share + later, -1.0, 1.0))
    return other.led(dataclasses.replace(bench.lead, share=share))


def exact(bench: Bench) -> Bench | None:
    """With the classical Runge-Kutta method, whose error falls as the fourth power of the step, in
    the steps that there are; None where it is there. Longer ones would do for what is smooth, but
    not for stops."""
    if stepping(bench.scene).integrator == _RK4:
        return None
    return stepped(bench, taken(bench), _RK4)


def held(bench: Bench, timestep: float) -> Bench | None:
    """In steps over which forces are held, by MuJoCo's implicitfast integrator; None for those of
    another integrator than `exact` ones."""
    if stepping(bench.scene).integrator != _RK4:
        return None
    return stepped(bench, timestep, int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST))


def _early(bench: Bench) -> float:
    """By how much a force acts too early, s: MuJoCo's Euler and implicit integrators move a body by
    the velocity that a step ends with."""
    return 0.0 if stepping(bench.scene).integrator == _RK4 else taken(bench) / 2.0


_RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)


def peak(gains: dict[float, float], low: float, high: float) -> float | None:
    """Where the parabola through the best place and its neighbours is highest, within bounds; None
    where it has no peak.

    Args:
      gains: by places along a line.
    """
    known = sorted(place for place, value in gains.items() if np.isfinite(value))
    best = known.index(max(known, key=lambda place: gains[place]))
    first = min(max(best - 1, 0), len(known) - 3)
    if first < 0:
        return None
    near = known[first : first + 3]
    square, slope, _ = np.polyfit(np.array(near) / high, [gains[place] for place in near], 2)
    return float(np.clip(-slope / (2 * square) * high, low, high)) if square < 0 else None
