"""The timestep and the integrator of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from orbisim.effects.lateness import keep_late
from orbisim.recording import Recording
from orbisim.scene import Scene


class Stepping(NamedTuple):
    """How a scene is stepped.

    Attributes:
      timestep: s. integrator: of `mujoco.mjtIntegrator`.
      dry: whether friction loss stops a joint within two timesteps, the shortest `solreffriction`
        that MuJoCo takes, where its document leaves the default of 20 ms. With that, a joint that
        comes to rest creeps on for F / (2 m b^2), b = 105/s, beyond where friction F stops it.
      elliptic: whether friction cones of contacts are elliptic, as Coulomb's law has them, and not
        MuJoCo's default pyramids, along whose edges friction is up to 1.41 times as large.
    """

    timestep: float
    integrator: int
    dry: bool = False
    elliptic: bool = False

    def __str__(self) -> str:
        dry = ", friction that stops joints within two steps: solreffriction" if self.dry else ""
        cone = ", elliptic friction cones" if self.elliptic else ""
        return f"timestep of {self.timestep:.3g} s ({_NAMES[self.integrator]}{dry}{cone})"


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
    elliptic = bool(option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC)
    return Stepping(float(option.timestep), int(option.integrator), dry, elliptic)


def _short(timestep: float) -> float:
    """Time constant of the driest friction, s."""
    return float(min(_SOFT[0], 2.0 * timestep))


_SOFT = (0.02, 1.0)
"""MuJoCo's default of `solreffriction`: time constant, s, and damping ratio."""


def with_stepping(scene: Scene, other: Stepping) -> Scene:
    """The scene, stepped in another way, in which its drives are as late as they were."""
    spec, ends = scene.spec, (_SOFT[0], _short(scene.model.opt.timestep))
    keep_late(spec, scene.model, other.timestep, other.integrator)
    spec.option.timestep, spec.option.integrator = other.timestep, other.integrator
    cones = mujoco.mjtCone.mjCONE_ELLIPTIC, mujoco.mjtCone.mjCONE_PYRAMIDAL
    spec.option.cone = cones[0] if other.elliptic else cones[1]
    for joint in spec.joints:
        if joint.solref_friction[0] in ends and joint.solref_friction[1] == _SOFT[1]:
            joint.solref_friction[0] = _short(other.timestep) if other.dry else _SOFT[0]
    return Scene.from_spec(spec, source=scene.source, unsupported=scene.unsupported)


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
