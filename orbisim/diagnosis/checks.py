"""What is wrong with a scene, or with how it was simulated, before any effect is looked for."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from orbisim.effects import effect_names, find
from orbisim.scene import Scene
from orbisim.shooting.bench import Bench
from orbisim.shooting.shooter import Variant
from orbisim.shooting.windows import evenly


def coarse_timestep(bench: Bench, residual: float) -> str | None:
    """A note if free runs of the declared scene with half its timestep differ by what matters: what
    is left is then partly the integrator's, and no effect accounts for it.

    Args:
      residual: of the declared scene, over the noise.
    """
    shooter = bench.shooter(evenly(np.ones(len(bench.windows), bool), _MOST))
    still = np.zeros((len(shooter), 2 * shooter.nv))
    variant, finer = Variant(bench.scene), copy.copy(shooter)
    finer.substeps = 2 * shooter.substeps
    runs = [one.scaled(one.simulate(variant, still)) for one in (shooter, finer)]
    apart = np.sqrt(np.mean((runs[1] - runs[0]) ** 2, axis=1))
    ratio = float(np.median(apart))  # windows with impacts differ in any case
    if not ratio > max(_SHOWS, _PART * residual):
        return None
    step = float(bench.scene.model.opt.timestep)
    return (
        f"with half the timestep ({step / 2:g} s instead of {step:g} s) free runs differ by "
        f"{ratio:.3g} times the noise: the timestep is too long for these data; shorten it in "
        "<option timestep>"
    )


_SHOWS = 1.0
"""Difference over noise, root mean square in a typical window, from which on it matters."""
_PART = 0.3
"""... and share of the residual."""
_MOST = 24
"""Windows that are simulated twice."""


def disabled(scene: Scene) -> str | None:
    """A note on effects that a disabled flag of the scene makes impossible."""
    flags = int(scene.model.opt.disableflags)
    off = {bit for name in effect_names() for bit in find(name).needs if flags & int(bit)}
    if not off:
        return None
    gone = [name for name in effect_names() if set(find(name).needs) & off]
    names = ", ".join(sorted(_flag(bit) for bit in off))
    return (
        f"the scene disables {names} (<option><flag/>), so that {', '.join(gone)} can have no "
        "effect in it: they were not looked for"
    )


def _flag(bit: mujoco.mjtDisableBit) -> str:
    return bit.name.removeprefix("mjDSBL_").lower()
