"""Physical effects that a scene may lack: a catalogue, their MJCF form, their simulation."""

from orbisim.effects.base import Effect, EffectInstance, Hook, Parameter, StepInputs
from orbisim.effects.carry import add_effects, carried_effects
from orbisim.effects.catalogue import effect_names, find, register

__all__ = [
    "Effect",
    "EffectInstance",
    "Hook",
    "StepInputs",
    "Parameter",
    "add_effects",
    "carried_effects",
    "effect_names",
    "find",
    "register",
]
