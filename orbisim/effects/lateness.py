"""How late drives act in timesteps: the numbers that MJCF is given for a lag and for a delay.

A control is held over timesteps h. What passes a first-order lag of time constant tau moves a mass
as much later, on average.

Integrators that hold the force of a step, too, move a mass by the velocity that the step ends with:
velocities are those half a step before, and a force acts from half a step before the step to half a
step after its beginning (the leapfrog scheme: Hairer, Lubich and Wanner, Geometric Numerical
Integration, 2006, section I.1.4). `filterexact` gives the lag's own value at the step's beginning,
in the middle of that: positions are late by h / (1 - exp(-h / tau)) - h / 2, about
tau + h^2 / (12 tau).

RK4 integrates `filter` with all else, and its stages see what it becomes during a step: it is late
by tau in steps of any length. `filterexact` advances by its own formula from the mean of the
stages' derivatives, as if they were those of the step's beginning, and is late by half a step more.
Below half a step RK4 no longer follows `filter`; with `actearly`, which shortens its mean by a
step, it follows one that is longer by a step.

What depends on the step here is written for the scene's own. In other steps, `kept_late` says with
which numbers drives are as late as in that.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


class Dynamics(NamedTuple):
    """Of an actuator's activation, as MJCF has it: `dyntype`, `actearly` and `dynprm`, s."""

    kind: mujoco.mjtDyn
    early: bool
    number: float


def lag(time_constant: float, step: float, integrator: int) -> Dynamics:
    """What is late by a time constant, s, in timesteps of a scene.

    Args:
      integrator: of `mujoco.mjtIntegrator`.
    """
    if integrator != _RK4:
        return Dynamics(mujoco.mjtDyn.mjDYN_FILTEREXACT, False, time_constant)
    early = time_constant < 0.5 * step
    return Dynamics(_FILTER, early, time_constant + step * early)


def delay(seconds: npt.ArrayLike, step: npt.ArrayLike, integrator: int) -> Floats:
    """The MJCF `delay`, s, by which a control is late by a delay [...] on average.

    RK4 reads it at stages 0, 1/2, 1/2 and 1 of a step, with weights 1, 4 (both) and 1 of six: a
    delay D is one of D, D - step / 2 and D - step after the step began, but none is less than a
    step: what was set since then is not in the history yet. The mean of these is D - step / 2 from
    two steps on, and linear between the delays at which one of them gets longer than a step.
    """
    late, step = np.asarray(seconds, np.float64), np.asarray(step, np.float64)
    if integrator != _RK4:
        return late * np.ones_like(step)
    return step * _beyond(late / step, _MEANS, _GIVEN)


def kept_late(
    model: mujoco.MjModel, steps: Floats, integrator: int | None = None
) -> dict[str, Floats]:
    """Fields of a model with which drives are as late in other steps as in the model's own.

    Args:
      steps: [n] of worlds, s. integrator: another than the model's, of `mujoco.mjtIntegrator`.

    Returns:
      Those that depend on the step, by name, each [n, nactuator, ...].
    """
    own, before = float(model.opt.timestep), int(model.opt.integrator)
    after, found = before if integrator is None else integrator, dict[str, Floats]()
    early = model.actuator_actearly.astype(bool) & (model.actuator_dyntype == _FILTER)
    if early.any() and before == _RK4:
        found["actuator_dynprm"] = np.repeat(model.actuator_dynprm[None], len(steps), axis=0)
        found["actuator_dynprm"][:, early, 0] += steps[:, None] - own
    given = np.asarray(model.actuator_delay, np.float64)
    if given.any() and _RK4 in (before, after):
        late = own * _beyond(given / own, _GIVEN, _MEANS) if before == _RK4 else given
        found["actuator_delay"] = np.where(given > 0, delay(late, steps[:, None], after), 0.0)
    return found


def keep_late(spec: mujoco.MjSpec, model: mujoco.MjModel, step: float, integrator: int) -> None:
    """Edits a document so that its drives are as late in another step, s, and by another integrator
    of `mujoco.mjtIntegrator`.

    Args:
      model: as the document compiles.
    """
    late = kept_late(model, np.array([step]), integrator)
    for number, actuator in enumerate(spec.actuators):
        if "actuator_dynprm" in late:
            actuator.dynprm[0] = late["actuator_dynprm"][0, number, 0]
        if "actuator_delay" in late:
            actuator.delay = late["actuator_delay"][0, number]


def _beyond(places: Floats, known: tuple[float, ...], values: tuple[float, ...]) -> Floats:
    """A line through points, that goes on with a slope of one on both sides of them."""
    low, high = np.minimum(places - known[0], 0.0), np.maximum(places - known[-1], 0.0)
    return np.asarray(np.interp(places, known, values) + low + high)


_GIVEN, _MEANS = (1.0, 1.5, 2.0), (1.0, 13.0 / 12.0, 1.5)
"""Delays that MJCF is given, and what they are on average over the stages of RK4, both in steps."""
_FILTER = mujoco.mjtDyn.mjDYN_FILTER
_RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)
