"""Effects at actuators."""

from __future__ import annotations

import mujoco
import numpy as np

from orbisim.effects.base import (
    LARGE,
    Effect,
    EffectInstance,
    Hook,
    Parameter,
    StepInputs,
    actuator_unit,
    index_of,
    spec_element,
)
from orbisim.effects.lateness import delay, lag
from orbisim.effects.screening import Candidate, Column, Floats, MotionRegressors, keyed
from orbisim.effects.servo_offsets import same_offsets
from orbisim.errors import InputError

_AFFINE = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))


class ActuatorEffect(Effect):
    """An effect at an actuator that reads one control."""

    kind = "actuator"
    needs = (mujoco.mjtDisableBit.mjDSBL_ACTUATION,)

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
    declared_as = "gain"
    family = "drive"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        half, twice = 0.5, 2.0  # what is further off is another motor
        limits = (half, twice)
        return (
            Parameter("gain", "1", -10.0, 100.0, 1.0, neutral=1.0, usual=_WEAKER, possible=limits),
        )

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        actuator = spec_element(spec, "actuator", instance.target)
        gain = instance.values["gain"]
        actuator.gainprm[:3] = np.asarray(actuator.gainprm[:3]) * gain
        actuator.biasprm[:3] = np.asarray(actuator.biasprm[:3]) * gain

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        index = index_of(view.model, "actuator", target)
        force = _force(view, index, view.actuator_force[:, index])
        return [Candidate(self.name, target, (force,), lambda c: {"gain": 1.0 + float(c[0])})]


class TorqueBias(ActuatorEffect):
    """A constant added to the actuator's output force."""

    name = "torque_bias"
    common = True
    rarity = -1.0
    phrase = "an offset in the output"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("offset", actuator_unit(model, target), -LARGE, LARGE, 0.1),)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        actuator = spec_element(spec, "actuator", instance.target)
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.biasprm[0] += instance.values["offset"]

    def equivalents(self, model: mujoco.MjModel, instance: EffectInstance) -> list[EffectInstance]:
        return same_offsets(model, instance)

    def adds_force(self) -> bool:
        """Of actuators' effects this one alone: a force is recorded with its offset."""
        return True

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        index = index_of(view.model, "actuator", target)
        force = _force(view, index, np.ones(len(view.time)))
        return [Candidate(self.name, target, (force,), keyed("offset"))]


class TorqueSaturation(ActuatorEffect):
    """The output force is limited: MJCF `forcerange`."""

    name = "torque_saturation"
    phrase = "a limit of the output"
    family = "drive"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("limit", actuator_unit(model, target), 1e-9, LARGE, 1.0),)

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

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        index = index_of(view.model, "actuator", target)
        force = view.actuator_force[:, index]
        size = np.abs(force)
        # shares of the largest, too: most commands of one that switches are at their ends
        shares = np.array([0.25, 0.5, 0.75]) * size.max(initial=0.0)
        quantiles = np.quantile(size, [0.15, 0.3, 0.5, 0.65, 0.8, 0.9, 0.96])
        levels = np.unique(np.concatenate([quantiles, shares]))
        return [
            _known(
                self.name, target, _force(view, index, np.clip(force, -x, x) - force), {"limit": x}
            )
            for x in levels
            if x > 0
        ]


class ActuatorLag(ActuatorEffect):
    """A first-order lag of the control: MJCF `filterexact`, or `filter`, which RK4 integrates with
    all else (`orbisim.effects.lateness`)."""

    name = "actuator_lag"
    phrase = "a first-order lag"
    family = "late"
    structural = True

    def possible(self, model: mujoco.MjModel, target: str) -> bool:
        """Actuators without dynamics of their own."""
        i = index_of(model, "actuator", target)
        return super().possible(model, target) and model.actuator_dyntype[i] == 0

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("time_constant", "s", 1e-5, 10.0, 0.02),)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        actuator = spec_element(spec, "actuator", instance.target)
        option = spec.option
        form = lag(instance.values["time_constant"], option.timestep, int(option.integrator))
        actuator.dyntype, actuator.actearly = form.kind, form.early
        actuator.dynprm[0] = form.number

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        index = index_of(view.model, "actuator", target)
        control = int(view.model.actuator_ctrladr[index])
        gain, now = view.control_gain(index), view.ctrl[:, control]
        return [
            _known(
                self.name,
                target,
                _force(view, index, gain * (view.filtered_control(control, tau) - now)),
                {"time_constant": float(tau)},
            )
            for tau in _TIMES
        ]


class ActuatorDelay(ActuatorEffect):
    """A pure delay of the control: MJCF `delay`, a whole timestep at least.

    Between timesteps the control is interpolated (`interp="linear"`): of one that is held between
    samples, that is its mean over a timestep, so that a delay need not be a number of timesteps.
    RK4 reads it at the stages of a step, of which three are later than the step begins: what MJCF
    is given is as much more as makes the mean over the stages late by the delay
    (`orbisim.effects.lateness`).
    """

    name = "actuator_delay"
    phrase = "a delay"
    family = "late"
    timing = True
    structural = True

    def possible(self, model: mujoco.MjModel, target: str) -> bool:
        """Actuators without a declared delay."""
        i = index_of(model, "actuator", target)
        return super().possible(model, target) and not model.actuator_delay[i]

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("delay", "s", 0.0, 2.0, 0.02),)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        actuator = spec_element(spec, "actuator", instance.target)
        step = spec.option.timestep
        actuator.delay = float(delay(instance.values["delay"], step, int(spec.option.integrator)))
        # a sampling interval takes a whole number of steps, down to half as long as declared
        actuator.nsample = max(2, int(np.ceil(2.0 * actuator.delay / step)) + 2)
        actuator.interp = 1

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        index = index_of(view.model, "actuator", target)
        control = int(view.model.actuator_ctrladr[index])
        gain, now = view.control_gain(index), view.ctrl[:, control]
        return [
            _known(
                self.name,
                target,
                _force(view, index, gain * (view.delayed_control(control, late) - now)),
                {"delay": float(late)},
            )
            for late in _TIMES
        ]


class Deadband(ActuatorEffect):
    """Controls within half the width of zero do nothing; the rest is moved towards zero by it.

    With `kind`: gate, controls beyond half the width act in full.
    """

    name = "deadband"
    phrase = "a dead band"
    family = "drive"
    native = False

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("width", "control", 0.0, LARGE, 0.1),)

    def stepwise(self, instance: EffectInstance, name: str) -> bool:
        return instance.options.get("kind") == "gate"

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        return _Deadband(model, instance)

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        index = index_of(view.model, "actuator", target)
        u = view.ctrl[:, int(view.model.actuator_ctrladr[index])]
        gain, found = view.control_gain(index), []
        for half in np.unique(np.quantile(np.abs(u), [0.05, 0.1, 0.2, 0.3, 0.45, 0.6])):
            if half <= 0:
                continue
            shifted = np.where(np.abs(u) > half, u - np.sign(u) * half, 0.0)
            gated = np.where(np.abs(u) > half, u, 0.0)
            for kind, passed in (("shift", shifted), ("gate", gated)):
                column = _force(view, index, gain * (passed - u))
                values = {"width": 2 * float(half)}
                found.append(_known(self.name, target, column, values, {"kind": kind}))
        return found


_WEAKER = 0.1
"""Torque constants are known to 5 to 10 %, of warm motors and of gears less."""
_TIMES = np.geomspace(0.002, 0.4, 16)
"""Time constants and delays that are tried, s."""


def _force(view: MotionRegressors, actuator: int, force: Floats) -> Column:
    """A scalar actuator force [M] as a generalized force."""
    return Column("force", view.moment(actuator) * force[:, None])


def _known(
    effect: str,
    target: str,
    column: Column,
    values: dict[str, float],
    options: dict[str, str] | None = None,
) -> Candidate:
    """A candidate whose size follows from its parameter."""
    return Candidate(
        effect, target, (column,), lambda c: values, options or {}, fixed=True, shape=1
    )


class _Deadband(Hook):
    def __init__(self, model: mujoco.MjModel, instance: EffectInstance) -> None:
        super().__init__(instance.values)
        actuator = index_of(model, "actuator", instance.target)
        self._control = int(model.actuator_ctrladr[actuator])
        kind = instance.options.get("kind", "shift")
        if kind not in ("shift", "gate"):
            raise InputError(f"deadband: kind is shift or gate; got {kind!r}")
        self._gate = kind == "gate"

    def control(self, inputs: StepInputs) -> None:
        control, half = inputs.ctrl[:, self._control], self.value("width") / 2
        beyond = np.abs(control) > half
        kept = control if self._gate else control - np.sign(control) * half
        inputs.ctrl[:, self._control] = np.where(beyond, kept, 0.0)
