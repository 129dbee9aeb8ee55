"""The timestep of a scene along recordings."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np

from orbisim.motion.samples import substeps
from orbisim.scene import Scene
from orbisim.shooting.bench import Bench


def typical_interval(bench: Bench) -> float:
    """Between samples, s."""
    return float(np.median(np.concatenate([np.diff(one.time) for one in bench.samples])))


def taken(bench: Bench, timestep: float | None = None) -> float:
    """The step that a timestep means (the scene's if None), s: a typical sampling interval has a
    whole number of them."""
    timestep = float(bench.scene.model.opt.timestep) if timestep is None else timestep
    interval = typical_interval(bench)
    return interval / int(substeps(interval, timestep))


def with_timestep(scene: Scene, timestep: float) -> Scene:
    """The scene with another timestep, s."""
    spec = scene.spec
    spec.option.timestep = timestep
    return Scene.from_spec(spec, source=scene.source, unsupported=scene.unsupported)


def stepped(bench: Bench, timestep: float) -> Bench:
    """With another timestep, and controls that are looked for between samples where they do the
    same: MuJoCo's Euler and implicit integrators move a body by the velocity that a step ends with,
    so that a force acts half a step early."""
    other = dataclasses.replace(bench, scene=with_timestep(bench.scene, timestep))
    if not bench.lead or bench.scene.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        return other
    later = (taken(bench) - taken(other)) / (2 * typical_interval(bench))
    share = float(np.clip(bench.lead.share + later, -1.0, 1.0))
    return other.led(dataclasses.replace(bench.lead, share=share))


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
