"""Laws that have no name in the catalogue.

A diagnosis must not call something by the least bad name. Where it takes several named effects to
imitate what one smooth law does as well, the law is the better explanation, and no name is given.
These laws are effects in every technical respect, but no report lists them as found.
"""

from __future__ import annotations

import abc
from collections.abc import Callable

import mujoco
import numpy as np

from orbisim.effects.base import LARGE, EffectInstance, Hook, Parameter, StepInputs, index_of
from orbisim.effects.joints import JointEffect
from orbisim.effects.screening import Floats
from orbisim.effects.sensors import MeasurementEffect

POWERS = 4
"""Up to the cube: a law with more bends would follow the noise."""

Along = Callable[[StepInputs, int, int], tuple[Floats, Floats]]
"""What a law is a polynomial of, and what it is multiplied by, each [nworld], from the inputs and
the joint's addresses in qpos and qvel."""


class Law(JointEffect):
    """A generalized force at a joint that no effect of the catalogue is."""

    native = False
    rarity = -2.0

    @abc.abstractmethod
    def beginnings(self, q: Floats) -> list[dict[str, float]]:
        """Values to begin a fit with.

        Args:
          q: [T] positions of the joint.
        """


class PolynomialLaw(Law):
    """A polynomial of the third degree."""

    derived: frozenset[str] = frozenset()

    @abc.abstractmethod
    def along(self, inputs: StepInputs, q: int, v: int) -> tuple[Floats, Floats]:
        """What it is a polynomial of, and a factor, each [nworld]; joint's addresses given."""

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return tuple(Parameter(f"c{k}", "SI", -LARGE, LARGE, 0.1) for k in range(POWERS))

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        return _Polynomial(model, instance, self.along, self.derived)

    def beginnings(self, q: Floats) -> list[dict[str, float]]:
        return [{f"c{k}": 0.0 for k in range(POWERS)}]


class PositionLaw(PolynomialLaw):
    """Of the position."""

    name = "law_of_position"
    phrase = "a force that is a smooth function of the position"

    def along(self, inputs: StepInputs, q: int, v: int) -> tuple[Floats, Floats]:
        return inputs.qpos[:, q], np.ones(len(inputs.time))


class VelocityLaw(PolynomialLaw):
    """Of the velocity."""

    name = "law_of_velocity"
    phrase = "a force that is a smooth function of the velocity"

    def along(self, inputs: StepInputs, q: int, v: int) -> tuple[Floats, Floats]:
        return inputs.qvel[:, v], np.ones(len(inputs.time))


class GainLaw(PolynomialLaw):
    """Of the time, times the actuators' force at the joint."""

    name = "law_of_gain"
    phrase = "a gain that drifts with time"
    derived = frozenset({"qfrc_actuator"})

    def along(self, inputs: StepInputs, q: int, v: int) -> tuple[Floats, Floats]:
        return inputs.time, inputs.derived["qfrc_actuator"][:, v]


class OneSidedLaw(Law):
    """A spring and a damper that act beyond a position only: a slack cord, a soft stop."""

    name = "law_of_one_side"
    phrase = "a spring that acts beyond a position only"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (
            Parameter("stiffness", "SI", -LARGE, LARGE, 0.1),
            Parameter("damping", "SI", -LARGE, LARGE, 0.1),
            Parameter("position", "SI", -LARGE, LARGE, 0.1),
            Parameter("side", "1", -1.0, 1.0, 1.0, choice=True),
        )

    def free_parameters(self, model: mujoco.MjModel, target: str) -> tuple[str, ...]:
        """All but the side."""
        return ("stiffness", "damping", "position")

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        return _OneSided(model, instance)

    def beginnings(self, q: Floats) -> list[dict[str, float]]:
        """Nothing yet, on both sides of three positions."""
        return [
            {"stiffness": 0.0, "damping": 0.0, "position": float(place), "side": side}
            for place in np.quantile(q, (0.25, 0.5, 0.75))
            for side in (1.0, -1.0)
        ]


class ReadingLaw(MeasurementEffect):
    """A hinge's sensor reads, beside an offset, too much by waves of one and two periods a turn: a
    disk that is mounted beside its axis, or tilted. A scale and an offset are its tangent."""

    name = "law_of_reading"
    phrase = "a reading that is off by a smooth function of the position"
    measured_as = "law"
    rarity = -2.0

    def possible(self, model: mujoco.MjModel, target: str) -> bool:
        """At hinges."""
        joint = index_of(model, "joint", target)
        return int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_HINGE)

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return tuple(Parameter(name, "rad", -1.0, 1.0, 0.02) for name in READING)

    def beginnings(self, q: Floats) -> list[dict[str, float]]:
        """As if there was none."""
        return [dict.fromkeys(READING, 0.0)]


READING = ("offset", "cos1", "sin1", "cos2", "sin2")
"""Numbers of a law of reading: the reading is too large by offset + cos1 cos(q) + sin1 sin(q) +
cos2 cos(2 q) + sin2 sin(2 q)."""

UNNAMED: tuple[type[Law] | type[ReadingLaw], ...] = (
    PositionLaw,
    VelocityLaw,
    GainLaw,
    OneSidedLaw,
    ReadingLaw,
)


class _OneSided(Hook):
    def __init__(self, model: mujoco.MjModel, instance: EffectInstance) -> None:
        super().__init__(instance.values)
        joint = index_of(model, "joint", instance.target)
        self._q, self._v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])

    def force(self, inputs: StepInputs) -> None:
        beyond = inputs.qpos[:, self._q] - self.value("position")
        push = self.value("stiffness") * beyond + self.value("damping") * inputs.qvel[:, self._v]
        inputs.qfrc[:, self._v] -= np.where(self.value("side") * beyond > 0, push, 0.0)


class _Polynomial(Hook):
    def __init__(
        self,
        model: mujoco.MjModel,
        instance: EffectInstance,
        along: Along,
        derived: frozenset[str],
    ) -> None:
        super().__init__(instance.values)
        joint = index_of(model, "joint", instance.target)
        self._q, self._v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        self._along, self.derived = along, derived

    def force(self, inputs: StepInputs) -> None:
        x, factor = self._along(inputs, self._q, self._v)
        powers = sum(self.value(f"c{k}") * x**k for k in range(POWERS))
        inputs.qfrc[:, self._v] += factor * powers
