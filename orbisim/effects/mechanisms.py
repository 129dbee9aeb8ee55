"""Effects that make a mechanism of joints: latches and detents.

A scene declares them (a lock that a handle releases, a knob that clicks); no diagnosis looks for
them. Both are functions of the positions, so that a state holds all there is to know of a lock.
"""

from __future__ import annotations

import mujoco
import numpy as np

from orbisim.effects.base import (
    EffectInstance,
    Hook,
    Parameter,
    StepInputs,
    index_of,
    is_scalar_joint,
    joint_unit,
)
from orbisim.effects.joints import JointEffect
from orbisim.errors import InputError, UnknownNameError

_LARGE = 1e6
SIDES = {"above": 1.0, "below": -1.0}
"""Option `side` of a latch: where the other joint must be to release it."""


class Latch(JointEffect):
    """Dry friction that holds a joint near a position until another joint releases it.

    While |q - position| <= width and the joint of the option `other` is not beyond `threshold` (on
    the option's `side`, `above` or `below`), the joint's friction loss is larger by `force`: a lock
    where that is more than anything can pull, a catch where it is less. Without `other` nothing
    releases it but force.
    """

    name = "latch"
    phrase = "a latch"
    native = False

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        unit, way = joint_unit(model, target, "N*m", "N"), joint_unit(model, target, "rad", "m")
        return (
            Parameter("force", unit, 0.0, _LARGE, 1.0),
            Parameter("position", way, -100.0, 100.0, 0.0),
            Parameter("width", way, 0.0, 100.0, 0.01),
            Parameter("threshold", "SI", -100.0, 100.0, 0.1),
        )

    def check_values(self, model: mujoco.MjModel, instance: EffectInstance) -> None:
        super().check_values(model, instance)
        options = instance.options
        if unknown := sorted(set(options) - {"other", "side"}):
            raise UnknownNameError("option of latch", unknown[0], ("other", "side"))
        if "other" in options and not is_scalar_joint(model, options["other"]):
            raise InputError(
                f"latch at {instance.target!r}: {options['other']!r} is not a hinge or a slide"
            )
        if options.get("side", "above") not in SIDES:
            raise UnknownNameError("side of a latch", options["side"], SIDES)

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        return _LatchHook(model, instance)


class Detent(JointEffect):
    """A force -A sin(2 pi (q - position) / pitch) that draws a joint to places a pitch apart."""

    name = "detent"
    phrase = "detents"
    native = False

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        unit, way = joint_unit(model, target, "N*m", "N"), joint_unit(model, target, "rad", "m")
        return (
            Parameter("amplitude", unit, 0.0, _LARGE, 0.1),
            Parameter("pitch", way, 1e-6, 100.0, 0.5),
            Parameter("position", way, -100.0, 100.0, 0.0),
        )

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        return _DetentHook(model, instance)


MECHANISMS: tuple[type[JointEffect], ...] = (Latch, Detent)


class _LatchHook(Hook):
    def __init__(self, model: mujoco.MjModel, instance: EffectInstance) -> None:
        super().__init__(instance.values)
        joint = index_of(model, "joint", instance.target)
        self._q, self._v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        other = instance.options.get("other")
        self._other = (
            None if other is None else int(model.jnt_qposadr[index_of(model, "joint", other)])
        )
        self._side = SIDES[instance.options.get("side", "above")]

    def fields(self, inputs: StepInputs) -> None:
        away = np.abs(inputs.qpos[:, self._q] - self.value("position"))
        engaged = away <= self.value("width")
        if self._other is not None:
            beyond = inputs.qpos[:, self._other] - self.value("threshold")
            engaged = engaged & ~(self._side * beyond > 0)
        losses = inputs.fields["dof_frictionloss"]
        losses[:, self._v] += np.where(engaged, self.value("force"), 0.0)


class _DetentHook(Hook):
    def __init__(self, model: mujoco.MjModel, instance: EffectInstance) -> None:
        super().__init__(instance.values)
        joint = index_of(model, "joint", instance.target)
        self._q, self._v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])

    def force(self, inputs: StepInputs) -> None:
        away = inputs.qpos[:, self._q] - self.value("position")
        wave = np.sin(2 * np.pi * away / self.value("pitch"))
        inputs.qfrc[:, self._v] -= self.value("amplitude") * wave
