"""The catalogue of effects, open to third parties.

A package registers its own with the entry point group `orbisim.effects`, or calls `register`.
"""

from __future__ import annotations

import copy
import functools

from orbisim import plugins
from orbisim.effects import actuators, bodies, contacts, joints, mechanisms, sensors, unnamed
from orbisim.effects.base import Effect
from orbisim.errors import InputError, UnknownNameError

GROUP = "orbisim.effects"

_BUILT_IN: tuple[type[Effect], ...] = (
    joints.CoulombFriction,
    joints.ViscousDamping,
    joints.QuadraticDamping,
    joints.StribeckFriction,
    joints.LoadDependentFriction,
    joints.JointSpring,
    joints.Armature,
    joints.Cogging,
    joints.Backlash,
    joints.JointFlexibility,
    joints.HardStop,
    joints.JointCoupling,
    mechanisms.Latch,
    actuators.TorqueGain,
    actuators.TorqueBias,
    actuators.TorqueSaturation,
    actuators.Deadband,
    actuators.ActuatorLag,
    actuators.ActuatorDelay,
    bodies.Payload,
    bodies.ComOffset,
    bodies.ConstantForce,
    bodies.PeriodicDisturbance,
    bodies.LinearDrag,
    bodies.QuadraticDrag,
    bodies.Magnus,
    bodies.Buoyancy,
    bodies.GravityTilt,
    contacts.SlidingFriction,
    contacts.TorsionalFriction,
    contacts.RollingFriction,
    contacts.AnisotropicFriction,
    contacts.Restitution,
    contacts.ContactCompliance,
    contacts.Adhesion,
    sensors.SensorBias,
    sensors.SensorScale,
    sensors.SensorDelay,
    sensors.ClockSkew,
)

_registered: dict[str, Effect] = {cls.name: cls() for cls in _BUILT_IN}
_UNSOUGHT: tuple[type[Effect], ...] = (*unnamed.UNNAMED, mechanisms.Detent)
_not_sought: dict[str, Effect] = {cls.name: cls() for cls in _UNSOUGHT}


def effect_names() -> tuple[str, ...]:
    """Names of all effects that a diagnosis may give."""
    return tuple(dict.fromkeys([*_registered, *plugins.names(GROUP)]))


def register(effect: Effect) -> None:
    """Adds an effect to the catalogue.

    Raises:
      InputError: it is not an effect, or another has its name.
    """
    if not isinstance(effect, Effect):
        raise InputError(f"an effect is an object of a subclass of Effect; got {effect!r}")
    if effect.name in _registered and type(_registered[effect.name]) is not type(effect):
        raise InputError(f"there is an effect named {effect.name!r} already")
    _registered[effect.name] = effect


def find(name: str) -> Effect:
    """The effect of that name.

    Raises:
      UnknownNameError: there is none.
    """
    if name in _not_sought:
        return _not_sought[name]
    if name not in _registered:
        if name not in plugins.names(GROUP):
            raise UnknownNameError("effect", name, effect_names())
        register(plugins.load(GROUP, name, "effect")())
    return _registered[name]


def asked_once(name: str) -> Effect:
    """The effect of that name, which works out its parameters in a model once: a selection asks for
    the prior odds of a million values."""
    effect = copy.copy(find(name))
    setattr(effect, "parameters", functools.cache(effect.parameters))  # noqa: B010 (a method)
    return effect
