"""What can be predicted through impacts, and how well.

An impact is a matter of fractions of a millimetre and of a millisecond: a start that is off by a
part of the noise, or a step half as long, gives another impulse, and what comes after it is
another motion. How much another is measured here, in free runs of the declared scene and anew of
each form of it that is taken: from starts beside a window's, and in half the step. Both grow with
what the signal does by itself, and nothing in a fit makes them smaller, so that they count as a
second noise (`Windows.scatter`), with a standard deviation of its own at each sample. Where even
the mean is unknown, a window ends (`Windows.horizon`).
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import numpy.typing as npt
import scipy.ndimage

from orbisim.errors import OrbiSimError
from orbisim.motion.linear import Intervals
from orbisim.motion.samples import Samples
from orbisim.shooting.shooter import Shooter, Variant
from orbisim.shooting.stepping import stepping, with_stepping
from orbisim.shooting.windows import KNOWN, Windows, start_size

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Noise = tuple[Floats, Floats]


def near_jump(one: Samples) -> Bools:
    """[T]: whether an impact is so close that the reference is not to be trusted as a start."""
    jump = np.append(one.jumps.any(axis=1), False)
    near = jump.copy()
    for shift in range(1, _JUMP_REACH + 1):
        near[shift:] |= jump[:-shift]
        near[:-shift] |= jump[shift:]
    return near


_JUMP_REACH = 3
"""Samples to either side of an impact over which smoothing blurs it."""


def foreseen(shooter: Shooter, intervals: Intervals, windows: Windows, noise: Noise) -> Windows:
    """The windows with their horizons and with what scatters within.

    Runs from pairs of starts that differ by a part of the noise, to either side: half of their
    difference is how a start's error grows, which fits of starts make up for as long as it is
    known; half of what they differ on average from the run between them is what bends, which no
    derivative says.

    Args:
      shooter: of the windows, of the declared scene. intervals: where they lie. noise: standard
        deviations of positions and velocities.
    """
    measured, nv = np.isfinite(np.concatenate(noise)), shooter.nv
    size = start_size(noise, float(np.median(np.diff(shooter.time, axis=1))))
    rng = np.random.default_rng(0)
    variant, still = Variant(shooter.declared), np.zeros((len(shooter), 2 * nv))
    base = shooter.simulate(variant, still)
    growth, bend = np.zeros(shooter.shape), np.zeros(shooter.shape)
    for _ in range(_PROBES):
        start = KNOWN * size * rng.standard_normal(still.shape)
        one, other = ((shooter.simulate(variant, s) - base) / size for s in (start, -start))
        growth += np.nan_to_num(one - other, nan=np.inf) ** 2 / (4 * _PROBES)
        bend += np.nan_to_num(one + other, nan=np.inf) ** 2 / (4 * _PROBES)
    lost = growth > _GROWTH**2
    horizon = np.where(lost.any(axis=1), lost.argmax(axis=1) - 1, windows.length)
    horizon = np.where(measured, np.maximum(horizon, _SURE), 0)
    sigma = np.where(measured, np.concatenate(noise), 1.0)
    bend = bend * (size / sigma) ** 2
    scatter = np.sqrt(bend + (_of_the_step(shooter, intervals, noise, base) / sigma) ** 2)
    scatter = np.where(measured, np.where(np.isfinite(scatter), scatter, np.inf), 0.0)
    scatter = scipy.ndimage.maximum_filter1d(scatter, 2 * _BLUR + 1, axis=1)
    return dataclasses.replace(windows, horizon=horizon, scatter=scatter)


def _of_the_step(shooter: Shooter, intervals: Intervals, noise: Noise, base: Floats) -> Floats:
    """[W, K + 1, 2 nv]: by how much free runs are off for their step once there was an impact:
    twice what half of it changes, as the error of an impact falls like the step, whatever the
    integrator. What it does to all motion is left out: under MuJoCo's integrators but RK4,
    positions are ahead by half a step of what the velocity has changed.

    Args:
      base: the runs in the declared step, from the same starts.
    """
    near, k = [near_jump(one) for one in shooter.samples], shooter.windows.length
    rows = zip(shooter.recording, shooter.row, strict=True)
    after = np.maximum.accumulate(np.array([near[i][r : r + k + 1] for i, r in rows]), axis=1)
    if not after.any():
        return np.zeros(shooter.shape)
    known = stepping(shooter.declared)
    step = float(np.median(np.diff(shooter.time, axis=1))) / shooter.substeps
    try:
        finer = with_stepping(shooter.declared, known._replace(timestep=step / 2.0))
    except OrbiSimError:  # an effect that has no such step
        return np.zeros(shooter.shape)
    runs = Shooter(finer, shooter.samples, intervals, shooter.windows, noise, shooter.deadline)
    still = np.zeros((len(shooter), 2 * shooter.nv))
    apart = runs.simulate(Variant(finer), still) - base
    if known.integrator != int(mujoco.mjtIntegrator.mjINT_RK4):
        velocity = base[:, :, shooter.nv :] + shooter.qvel
        apart[:, :, : shooter.nv] += step / 4.0 * (velocity - velocity[:, :1])
    return np.where(after[..., None], 2.0 * apart, 0.0)


_PROBES = 3
"""Pairs of runs from starts apart by the noise; each pair moves all coordinates at random."""
_GROWTH = 60.0
"""Growth of a start's error, in units of the noise, beyond which nothing can be predicted."""
_SURE = 1
"""Samples that every window predicts in any case."""
_BLUR = 3
"""Samples to either side by which an impact of the machine may be off that of the declared scene:
what scatters there may scatter here."""
