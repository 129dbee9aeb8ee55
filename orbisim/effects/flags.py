"""Flags of a scene that switch parts of MuJoCo's pipeline off, and effects that need these parts.

A scene that disables constraints (as dm_control's acrobot does) has no dry friction and no stops; a
machine has. Such a flag says what a model leaves out, and that is what a diagnosis looks for. An
effect lifts the flags that it needs, and all else that they kept off stays off.
"""

from __future__ import annotations

from collections.abc import Iterable

import mujoco

_BITS = mujoco.mjtDisableBit
LIFTED = (_BITS.mjDSBL_CONSTRAINT, _BITS.mjDSBL_LIMIT, _BITS.mjDSBL_FRICTIONLOSS)
"""Flags that can be lifted for one effect, in the order in which that is done."""
_CONSTRAINTS = (
    _BITS.mjDSBL_EQUALITY,
    _BITS.mjDSBL_FRICTIONLOSS,
    _BITS.mjDSBL_LIMIT,
    _BITS.mjDSBL_CONTACT,
)
"""What `constraint` switches off all at once."""


def disabled_of(
    model: mujoco.MjModel, flags: Iterable[mujoco.mjtDisableBit]
) -> list[mujoco.mjtDisableBit]:
    """Those of the flags that a model sets."""
    return [flag for flag in flags if int(model.opt.disableflags) & int(flag)]


def impossible(model: mujoco.MjModel, needs: Iterable[mujoco.mjtDisableBit]) -> bool:
    """Whether a flag keeps off what an effect needs and cannot be lifted for it alone: a contact is
    an affair of two geoms and of all that collide, gravity acts on every body."""
    flags = set(needs)
    lasting = [f for f in flags if f not in LIFTED or _BITS.mjDSBL_CONTACT in flags]
    return bool(disabled_of(model, lasting))


def lift(spec: mujoco.MjSpec, needs: Iterable[mujoco.mjtDisableBit]) -> None:
    """Clears the flags that keep off what an effect needs; what else they kept off stays off.

    Args:
      needs: as `Effect.needs`.
    """
    needs = set(needs)
    for flag in LIFTED:
        if flag not in needs or not spec.option.disableflags & int(flag):
            continue
        spec.option.disableflags &= ~int(flag)
        if flag == _BITS.mjDSBL_CONSTRAINT:
            for kind in _CONSTRAINTS:
                spec.option.disableflags |= int(kind)
        for element in (*spec.joints, *spec.tendons):
            if flag == _BITS.mjDSBL_LIMIT:
                element.limited = mujoco.mjtLimited.mjLIMITED_FALSE
            elif flag == _BITS.mjDSBL_FRICTIONLOSS:
                element.frictionloss = 0.0
