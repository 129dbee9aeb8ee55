"""Dry friction with bristles, and everything else that acts at a joint."""

# ruff: noqa: D102 (overrides are documented in the base class)
from __future__ import annotations

import abc

import mujoco
import numpy as np

from rigs.law import Law, dof_of

_PRESLIDING = 2e-4
"""Deflection at which bristles slip, rad or m: well below what encoders resolve."""


class Bristles(Law, abc.ABC):
    """Dry friction of a level that subclasses give, as bristles that bend and slip.

    Canudas de Wit, Olsson, Astrom, Lischinsky (1995): dz/dt = v - s |v| z / g(v), force s z + d v
    while sticking. z is stepped implicitly, so that no speed makes it unstable.
    """

    def __init__(self, effect: str, joint: str, value: float, size: float) -> None:
        super().__init__(effect, joint, value, size)
        self._bend = 0.0

    def begin(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._dof, self._bend = dof_of(model, self.target), 0.0
        self._inertia = float(model.dof_M0[self._dof])

    @abc.abstractmethod
    def level(self, model: mujoco.MjModel, data: mujoco.MjData, speed: float) -> float:
        """The friction at which the joint slips."""

    def passive(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        level = self._level_now(model, data)
        data.qfrc_passive[self._dof] -= level * self._bend / _PRESLIDING
        # half of critical damping of the bristles while they do not slip; no more than half of the
        # level, so that a joint that moves feels the level alone
        stiff, stuck = level / _PRESLIDING, 1.0 - min(1.0, abs(self._bend) / _PRESLIDING)
        damping = np.sqrt(stiff * self._inertia) * float(data.qvel[self._dof])
        data.qfrc_passive[self._dof] -= stuck * min(max(damping, -level / 2), level / 2)

    def _level_now(self, model: mujoco.MjModel, data: mujoco.MjData) -> float:
        return max(0.0, self.level(model, data, float(data.qvel[self._dof])))

    def advance(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        speed, step = float(data.qvel[self._dof]), float(model.opt.timestep)
        self._bend = (self._bend + speed * step) / (1 + abs(speed) * step / _PRESLIDING)


class Coulomb(Bristles):
    """A level that never changes."""

    def level(self, model: mujoco.MjModel, data: mujoco.MjData, speed: float) -> float:
        return self.value


class Stribeck(Bristles):
    """A level that falls from `ratio` times the Coulomb level as the joint starts to move."""

    def __init__(self, joint: str, value: float, size: float, ratio: float, speed: float) -> None:
        super().__init__("stribeck_friction", joint, value, size)
        self._ratio, self._speed = ratio, speed

    def ways(self) -> list[Law]:
        more = 1 + 1.2 * (self._ratio - 1)
        return [self._with(ratio=more), self._with(speed=1.2 * self._speed)]

    def level(self, model: mujoco.MjModel, data: mujoco.MjData, speed: float) -> float:
        bump = (self._ratio - 1) * np.exp(-((speed / self._speed) ** 2))
        return float(self.value * (1 + bump))


class Loaded(Bristles):
    """A level in proportion to what the actuators put on the joint."""

    def level(self, model: mujoco.MjModel, data: mujoco.MjData, speed: float) -> float:
        return self.value * abs(float(data.qfrc_actuator[self._dof]))


class AtJoint(Law, abc.ABC):
    """A force at a joint that depends on its position q, velocity v and the time."""

    def begin(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        joint = model.dof_jntid[dof_of(model, self.target)]
        self._dof, self._q = dof_of(model, self.target), int(model.jnt_qposadr[joint])

    @abc.abstractmethod
    def force(self, q: float, v: float, time: float) -> float:
        """Generalized force on the joint."""

    def passive(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        q, v = float(data.qpos[self._q]), float(data.qvel[self._dof])
        data.qfrc_passive[self._dof] += self.force(q, v, float(data.time))


class Viscous(AtJoint):
    """-c v."""

    def force(self, q: float, v: float, time: float) -> float:
        return -self.value * v


class Quadratic(AtJoint):
    """-c v |v|."""

    def force(self, q: float, v: float, time: float) -> float:
        return -self.value * v * abs(v)


class Spring(AtJoint):
    """-k (q - rest)."""

    def __init__(self, joint: str, value: float, size: float, rest: float) -> None:
        super().__init__("joint_spring", joint, value, size)
        self._rest = rest

    def ways(self) -> list[Law]:
        return [self._with(rest=self._rest + 0.01)]

    def force(self, q: float, v: float, time: float) -> float:
        return -self.value * (q - self._rest)


class Teeth(AtJoint):
    """A sin(n q + phase): the detent of a motor's magnets."""

    def __init__(self, joint: str, value: float, size: float, periods: int, phase: float) -> None:
        super().__init__("cogging", joint, value, size)
        self._periods, self._phase = periods, phase

    def force(self, q: float, v: float, time: float) -> float:
        return float(self.value * np.sin(self._periods * q + self._phase))


class Stop(AtJoint):
    """A stiff spring and a damper beyond a position; value: the position."""

    def __init__(
        self, joint: str, value: float, size: float, side: float, stiff: float, damping: float
    ) -> None:
        super().__init__("hard_stop", joint, value, size)
        self._side, self._stiff, self._damping = side, stiff, damping

    def force(self, q: float, v: float, time: float) -> float:
        beyond = self._side * (q - self.value)
        if beyond <= 0:
            return 0.0
        # a stop pushes only
        return -self._side * max(0.0, self._stiff * beyond + self._damping * self._side * v)


class Hum(AtJoint):
    """A sin(2 pi f t + phase)."""

    def __init__(self, joint: str, value: float, size: float, rate: float, phase: float) -> None:
        super().__init__("periodic_disturbance", joint, value, size)
        self._rate, self._phase = rate, phase

    def force(self, q: float, v: float, time: float) -> float:
        return float(self.value * np.sin(2 * np.pi * self._rate * time + self._phase))


class Rotor(Law):
    """Inertia of the drive, as the joint feels it."""

    def tune(self, model: mujoco.MjModel) -> None:
        model.dof_armature[dof_of(model, self.target)] += self.value


class Crosstalk(Law):
    """A part of one joint's drive torque reaches another, as by a belt through it."""

    def __init__(self, joint: str, other: str, value: float, size: float) -> None:
        super().__init__("joint_coupling", joint, value, size)
        self._other = other

    def begin(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._to, self._from = dof_of(model, self.target), dof_of(model, self._other)

    def passive(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_passive[self._to] += self.value * (
            data.qfrc_actuator[self._from] + data.qfrc_applied[self._from]
        )
