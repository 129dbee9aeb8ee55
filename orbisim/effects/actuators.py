"""Effects at actuators."""

from __future__ import annotations

import mujoco
import numpy as np

from orbisim.effects.base import (
    Effect,
    EffectInstance,
    Hook,
    Moment,
    Parameter,
    index_of,
    spec_element,
)
from orbisim.errors import InputError

_LARGE = 1e6
_AFFINE = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))


class ActuatorEffect(Effect):
    """An effect at an actuator that reads one control."""

    kind = "actuator"

    def possible(self, model: mujoco.MjModel, target: str) -> bool:
        """Actuators with one control, and gain and bias that are affine."""
        i = index_of(model, "actuator", target)
        gains = (int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE))
        return bool(
            model.actuator_ctrlnum[i] == 1
            and int(model.actuator_gaintype[i]) in gains
            and int(model.actuator_biastype[i]) in _AFFINE
        )


class TorqueGain(ActuatorEffect):
    """The actuator gives another force than declared: gain and bias parameters scaled."""

    name = "torque_gain"
    phrase = "another gain"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("gain", "1", -10.0, 100.0, 1.0),)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        actuator = spec_element(spec, "actuator", instance.target)
        gain = instance.values["gain"]
        actuator.gainprm[:3] = np.asarray(actuator.gainprm[:3]) * gain
        actuator.biasprm[:3] = np.asarray(actuator.biasprm[:3]) * gain


class TorqueBias(ActuatorEffect):
    """A constant added to the actuator's output force."""

    name = "torque_bias"
    phrase = "an offset in the output"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("offset", "N*m or N", -_LARGE, _LARGE, 0.1),)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        actuator = spec_element(spec, "actuator", instance.target)
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.biasprm[0] += instance.values["offset"]


class TorqueSaturation(ActuatorEffect):
    """The output force is limited: MJCF `forcerange`."""

    name = "torque_saturation"
    phrase = "a limit of the output"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("limit", "N*m or N", 1e-9, _LARGE, 1.0),)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        actuator = spec_element(spec, "actuator", instance.target)
        limit = instance.values["limit"]
        low, high = actuator.forcerange
        if low < high:
            low, high = max(low, -limit), min(high, limit)
        else:
            low, high = -limit, limit
        actuator.forcerange = [low, high]
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE


class ActuatorLag(ActuatorEffect):
    """A first-order lag of the control: MJCF `dyntype="filterexact"`."""

    name = "actuator_lag"
    phrase = "a first-order lag"
    structural = True

    def possible(self, model: mujoco.MjModel, target: str) -> bool:
        """Actuators without dynamics of their own."""
        i = index_of(model, "actuator", target)
        return super().possible(model, target) and model.actuator_dyntype[i] == 0

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("time_constant", "s", 1e-5, 10.0, 0.02),)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        actuator = spec_element(spec, "actuator", instance.target)
        actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
        actuator.dynprm[0] = instance.values["time_constant"]


class ActuatorDelay(ActuatorEffect):
    """A pure delay of the control: MJCF `delay`, with the control held between samples."""

    name = "actuator_delay"
    phrase = "a delay"
    structural = True

    def possible(self, model: mujoco.MjModel, target: str) -> bool:
        """Actuators without a declared delay."""
        i = index_of(model, "actuator", target)
        return super().possible(model, target) and not model.actuator_delay[i]

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("delay", "s", 0.0, 2.0, 0.02),)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        actuator = spec_element(spec, "actuator", instance.target)
        delay = instance.values["delay"]
        actuator.delay = delay
        actuator.nsample = max(2, int(np.ceil(delay / spec.option.timestep)) + 2)
        actuator.interp = 0


class Deadband(ActuatorEffect):
    """Controls within half the width of zero do nothing; the rest is moved towards zero by it.

    With `kind`: gate, controls beyond half the width act in full.
    """

    name = "deadband"
    phrase = "a dead band"
    native = False

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("width", "control", 0.0, _LARGE, 0.1),)

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        return _Deadband(model, instance)


class _Deadband(Hook):
    def __init__(self, model: mujoco.MjModel, instance: EffectInstance) -> None:
        super().__init__(instance.values)
        actuator = index_of(model, "actuator", instance.target)
        self._control = int(model.actuator_ctrladr[actuator])
        kind = instance.options.get("kind", "shift")
        if kind not in ("shift", "gate"):
            raise InputError(f"deadband: kind is shift or gate; got {kind!r}")
        self._gate = kind == "gate"

    def control(self, moment: Moment) -> None:
        control, half = moment.ctrl[:, self._control], self.value("width") / 2
        beyond = np.abs(control) > half
        kept = control if self._gate else control - np.sign(control) * half
        moment.ctrl[:, self._control] = np.where(beyond, kept, 0.0)
