"""The timestep and the integrator of a scene along recordings."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from orbisim.effects.lateness import keep_late
from orbisim.motion.samples import substeps
from orbisim.recording import Recording
from orbisim.scene import Scene
from orbisim.shooting.bench import Bench


class Stepping(NamedTuple):
    """How a scene is stepped.

    Attributes:
      timestep: s. integrator: of `mujoco.mjtIntegrator`.
      dry: whether friction loss stops a joint within two timesteps, the shortest `solreffriction`
        that MuJoCo takes, where its document leaves the default of 20 ms. With that, a joint that
        comes to rest creeps on for F / (2 m b^2), b = 105/s, beyond where friction F stops it.
    """

    timestep: float
    integrator: int
    dry: bool = False

    def __str__(self) -> str:
        dry = ", friction that stops joints within two steps: solreffriction" if self.dry else ""
        return f"timestep of {self.timestep:.3g} s ({_NAMES[self.integrator]}{dry})"


_NAMES = {
    int(mujoco.mjtIntegrator.mjINT_EULER): "Euler",
    int(mujoco.mjtIntegrator.mjINT_RK4): "RK4",
    int(mujoco.mjtIntegrator.mjINT_IMPLICIT): "implicit",
    int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST): "implicitfast",
}
"""As MJCF has them."""


def stepping(scene: Scene) -> Stepping:
    """How a scene is stepped."""
    option, known = scene.model.opt, scene.model.dof_solref
    dry = _short(option.timestep) < _SOFT[0] and bool(
        np.any((known[:, 0] == _short(option.timestep)) & (known[:, 1] == _SOFT[1]))
    )
    return Stepping(float(option.timestep), int(option.integrator), dry)


def _short(timestep: float) -> float:
    """Time constant of the driest friction, s."""
    return float(min(_SOFT[0], 2.0 * timestep))


_SOFT = (0.02, 1.0)
"""MuJoCo's default of `solreffriction`: time constant, s, and damping ratio."""


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
    """The scene, stepped in another way, in which its drives are as late as they were."""
    spec, ends = scene.spec, (_SOFT[0], _short(scene.model.opt.timestep))
    keep_late(spec, scene.model, other.timestep, other.integrator)
    spec.option.timestep, spec.option.integrator = other.timestep, other.integrator
    for joint in spec.joints:
        if joint.solref_friction[0] in ends and joint.solref_friction[1] == _SOFT[1]:
            joint.solref_friction[0] = _short(other.timestep) if other.dry else _SOFT[0]
    return Scene.from_spec(spec, source=scene.source, unsupported=scene.unsupported)


def stepped(
    bench: Bench, timestep: float, integrator: int | None = None, dry: bool | None = None
) -> Bench:
    """With another timestep, and integrator and friction (`Stepping`) if these are given, and
    controls that are looked for between samples where they do the same."""
    known = stepping(bench.scene)
    changed = Stepping(
        timestep,
        known.integrator if integrator is None else integrator,
        known.dry if dry is None else dry,
    )
    other = dataclasses.replace(bench, scene=with_stepping(bench.scene, changed))
    if not bench.lead:
        return other
    later = (_early(bench) - _early(other)) / typical_interval(bench)
    share = float(np.clip(bench.lead.share + later, -1.0, 1.0))
    return other.led(dataclasses.replace(bench.lead, share=share))


def within_samples(scene: Scene, recordings: Sequence[Recording], notes: list[str]) -> Scene:
    """The scene in the step that is taken where samples are closer than its timestep, with a note
    then. What the timestep says beside how long a step is counts, too: how stiff a stop can be
    (`HardStop`), and by how much velocities are ahead of positions."""
    declared = stepping(scene)
    interval = float(np.median(np.concatenate([np.diff(one.time) for one in recordings])))
    if interval > _SAME * declared.timestep:
        return scene
    other = with_stepping(scene, declared._replace(timestep=interval))
    notes.append(
        f"samples are closer than the declared {declared}: free runs take a {stepping(other)}, "
        "and so does an augmented scene"
    )
    return other


_SAME = 0.95
"""Of a timestep: what is closer than that to it is a clock that jitters."""


def exact(bench: Bench, count: int) -> Bench:
    """With the classical Runge-Kutta method, whose error falls as the fourth power of the step, in
    so many steps between samples."""
    return stepped(bench, typical_interval(bench) / count, _RK4)


def is_exact(bench: Bench) -> bool:
    """Whether it has the steps of `exact`."""
    return stepping(bench.scene).integrator == _RK4


def held(bench: Bench, timestep: float) -> Bench | None:
    """In steps over which forces are held, by MuJoCo's implicitfast integrator, a whole number in a
    sampling interval; None for those of another integrator than `exact` ones."""
    if not is_exact(bench):
        return None
    interval, integrator = typical_interval(bench), int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    return stepped(bench, interval / max(round(interval / timestep), 1), integrator)


def _early(bench: Bench) -> float:
    """By how much a force acts too early, s: MuJoCo's Euler and implicit integrators move a body by
    the velocity that a step ends with."""
    return 0.0 if is_exact(bench) else taken(bench) / 2.0


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
