"""What a machine can have: bounds of effects by its geometry."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.samples import Samples
from orbisim.effects import EffectInstance
from orbisim.effects.base import index_of

_MOST_LOAD_FRICTION = 0.5
"""A transmission that loses half of what it carries could not be driven backwards."""
_FALLS = (0.01, 0.6)
"""Where friction may fall from static to Coulomb, in units of the joint's typical velocity."""
_BEYOND = 1.5
"""Something fixed to a body may stick out of it by half its reach."""


def sensible(
    model: mujoco.MjModel,
    instance: EffectInstance,
    duration: float = np.inf,
    travel: npt.NDArray[np.float64] | None = None,
) -> bool:
    """Whether such an effect can be: fitted values may be possible and yet absurd.

    A centre of mass lies within the reach of its body, and so, nearly, does what is fixed to it; a
    machine carries at most twice its own mass, and a body displaces at most twice its own;
    friction takes less than half of the load that a transmission carries; a gain is not off by
    more than a factor of two, nor a clock; what is periodic has come round twice.

    Args:
      duration: of the longest recording, s. travel: [nv] of each degree of freedom.
    """
    values = instance.values
    if not all(np.isfinite(value) for value in values.values()):
        return False
    if instance.effect == "payload":
        place = np.array([values[f"com_{axis}"] for axis in "xyz"])
        near = bool(np.linalg.norm(place) <= _BEYOND * reach(model, instance.target))
        return near and values["mass"] <= 2 * float(model.body_mass.sum())
    if instance.effect == "com_offset":
        return bool(values["offset"] <= reach(model, instance.target))
    if instance.effect == "buoyancy":
        mass = float(model.body_mass[index_of(model, "body", instance.target)])
        return values["displaced_mass"] <= 2 * mass
    if instance.effect == "load_dependent_friction":
        return values["coefficient"] <= _MOST_LOAD_FRICTION
    if instance.effect == "torque_gain":
        return 0.5 <= values["gain"] <= 2.0
    if instance.effect == "clock_skew":
        return 0.5 <= values["factor"] <= 2.0
    if instance.effect == "periodic_disturbance":
        return values["frequency"] * duration >= 2
    if instance.effect == "cogging" and travel is not None:
        dof = int(model.jnt_dofadr[index_of(model, "joint", instance.target)])
        return bool(values["periods"] * travel[dof] >= 4 * np.pi)
    return True


def absurd(
    model: mujoco.MjModel, instance: EffectInstance, samples: Sequence[Samples]
) -> str | None:
    """Why an effect with these numbers cannot be believed to act on a machine; None if it can."""
    if sensible(model, instance, *extent(samples)):
        return None
    return f"{instance} is nothing that this machine can have"


def hollow(
    model: mujoco.MjModel, instance: EffectInstance, samples: Sequence[Samples]
) -> str | None:
    """Why an effect is another one with fewer numbers; None if it is not.

    Stribeck friction that falls at a velocity far below those of the motion is Coulomb friction,
    and one that falls far above them is Coulomb friction with less damping.
    """
    if instance.effect != "stribeck_friction":
        return None
    dof = int(model.jnt_dofadr[index_of(model, "joint", instance.target)])
    speed = np.concatenate([one.qvel[one.usable, dof] for one in samples])
    low, high = (share * float(np.sqrt(np.mean(speed**2))) for share in _FALLS)
    at = instance.values["velocity"]
    if low <= at <= high:
        return None
    return (
        f"it falls at a velocity of {at:.3g}, where hardly any motion is (root mean square "
        f"{high / _FALLS[1]:.3g}): that is Coulomb friction"
    )


def reach(model: mujoco.MjModel, name: str) -> float:
    """Distance from a body's frame to the farthest of its geoms, children and centre of mass, m."""
    body = index_of(model, "body", name)
    far = [float(np.linalg.norm(model.body_ipos[body]))]
    for geom in np.flatnonzero(model.geom_bodyid == body):
        far.append(float(np.linalg.norm(model.geom_pos[geom]) + model.geom_rbound[geom]))
    for child in np.flatnonzero(model.body_parentid == body):
        if child != body:
            far.append(float(np.linalg.norm(model.body_pos[child])))
    return max(far)


def extent(samples: Sequence[Samples]) -> tuple[float, npt.NDArray[np.float64]]:
    """Duration of the longest recording, s, and travel [nv] of each degree of freedom."""
    longest = max(float(one.time[-1] - one.time[0]) for one in samples)
    nv = samples[0].absolute.shape[1] // 2
    q = np.concatenate([one.absolute[one.usable, :nv] for one in samples])
    return longest, np.asarray(np.ptp(q, axis=0))
