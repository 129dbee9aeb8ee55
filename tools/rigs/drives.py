"""What drives and transmissions do beyond their declaration."""

# ruff: noqa: D102 (overrides are documented in the base class)
from __future__ import annotations

import abc
import bisect

import mujoco
import numpy as np

from rigs.law import Floats, Law, index_of


class AtDrive(Law):
    """At an actuator."""

    def begin(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._index = index_of(model, "actuator", self.target)


class Gain(AtDrive):
    """The output is so many times what is declared."""

    def tune(self, model: mujoco.MjModel) -> None:
        index = index_of(model, "actuator", self.target)
        model.actuator_gainprm[index] *= self.value
        model.actuator_biasprm[index] *= self.value


class Offset(AtDrive):
    """The output has an offset (of an amplifier)."""

    def tune(self, model: mujoco.MjModel) -> None:
        index = index_of(model, "actuator", self.target)
        model.actuator_biastype[index] = int(mujoco.mjtBias.mjBIAS_AFFINE)
        model.actuator_biasprm[index, 0] += self.value


class Saturation(AtDrive):
    """The output has a limit."""

    def tune(self, model: mujoco.MjModel) -> None:
        index = index_of(model, "actuator", self.target)
        low, high = -self.value, self.value
        if model.actuator_forcelimited[index]:
            low = max(low, float(model.actuator_forcerange[index, 0]))
            high = min(high, float(model.actuator_forcerange[index, 1]))
        model.actuator_forcelimited[index] = 1
        model.actuator_forcerange[index] = low, high


class Deadzone(AtDrive):
    """Commands within half the width of zero do nothing; the others are less by that."""

    def command(self, time: float, command: Floats) -> None:
        given = command[self._index]
        command[self._index] = np.sign(given) * max(0.0, abs(given) - self.value / 2)


class Lag(AtDrive):
    """The command passes a first-order filter; value: its time constant."""

    def begin(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        super().begin(model, data)
        self._now: float | None = None
        self._keep = float(np.exp(-model.opt.timestep / self.value))
        self._mean = self.value / model.opt.timestep * (1 - self._keep)

    def command(self, time: float, command: Floats) -> None:
        given = float(command[self._index])
        left = 0.0 if self._now is None else self._now - given
        self._now = given + left * self._keep
        # the mean over the step: what it ends with is half a step early
        command[self._index] = given + left * self._mean


class Delay(AtDrive):
    """The command arrives late, by a time that is no multiple of anything."""

    def begin(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        super().begin(model, data)
        self._times: list[float] = []
        self._given: list[float] = []

    def command(self, time: float, command: Floats) -> None:
        self._times.append(time)
        self._given.append(float(command[self._index]))
        asked = time - self.value
        at = bisect.bisect_right(self._times, asked) - 1
        if at < 0 or at + 1 == len(self._times):
            command[self._index] = self._given[max(at, 0)]
            return
        # the mean over the step of what is held over steps: else a delay is a whole number of them
        part = (asked - self._times[at]) / (self._times[at + 1] - self._times[at])
        command[self._index] = (1 - part) * self._given[at] + part * self._given[at + 1]


class TwoMasses(Law, abc.ABC):
    """The rotor turns on its own, with a transmission between it and the link.

    The encoder is on the rotor's side. Declared armature and damping of the joint are the rotor's;
    the model's joint is the link. The rotor is stepped here (semi-implicit Euler).
    """

    instead = True

    def __init__(self, effect: str, joint: str, actuator: str, value: float, size: float) -> None:
        super().__init__(effect, joint, value, size)
        self._drive = actuator

    def tune(self, model: mujoco.MjModel) -> None:
        joint, drive = (
            index_of(model, "joint", self.target),
            index_of(model, "actuator", self._drive),
        )
        self._dof, self._adr = int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
        self._gear = float(model.actuator_gear[drive, 0])
        self._gain = float(model.actuator_gainprm[drive, 0])
        self._bias = model.actuator_biasprm[drive, :3].copy()
        limited = bool(model.actuator_forcelimited[drive])
        self._most = float(model.actuator_forcerange[drive, 1]) if limited else np.inf
        self._inertia = float(model.dof_armature[self._dof])
        self._damping = float(np.ravel(model.dof_damping[self._dof])[0])
        link = max(float(model.dof_M0[self._dof]) - self._inertia, 1e-12)
        self._reduced = self._inertia * link / (self._inertia + link)
        model.dof_armature[self._dof] = 0.0
        model.dof_damping[self._dof] = 0.0
        model.actuator_gainprm[drive] = 0.0
        model.actuator_biasprm[drive] = 0.0

    def begin(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._index = index_of(model, "actuator", self._drive)
        self._angle, self._speed = float(data.qpos[self._adr]), float(data.qvel[self._dof])
        self._given, self._through = 0.0, 0.0

    def command(self, time: float, command: Floats) -> None:
        self._given = float(command[self._index])

    @abc.abstractmethod
    def torque(self, twist: float, rate: float, step: float) -> float:
        """Through the transmission for its twist (rotor less link)."""

    def passive(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_passive[self._dof] += self._through  # one for the whole step, for both masses

    def advance(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        step, gear = float(model.opt.timestep), self._gear
        bias = self._bias @ [1.0, gear * self._angle, gear * self._speed]
        force = float(np.clip(self._gain * self._given + bias, -self._most, self._most))
        net = gear * force - self._damping * self._speed - self._through
        self._speed += step * net / self._inertia
        self._angle += step * self._speed
        twist = self._angle - float(data.qpos[self._adr])
        rate = self._speed - float(data.qvel[self._dof])
        self._through = self.torque(twist, rate, step)

    def shown(self, qpos: Floats, qvel: Floats) -> None:
        qpos[self._adr], qvel[self._dof] = self._angle, self._speed


class Elastic(TwoMasses):
    """A spring with damping; value: its stiffness."""

    def __init__(
        self, joint: str, actuator: str, value: float, size: float, damping: float
    ) -> None:
        super().__init__("joint_flexibility", joint, actuator, value, size)
        self._loss = damping

    def ways(self) -> list[Law]:
        return [self._with(loss=1.5 * self._loss)]

    def torque(self, twist: float, rate: float, step: float) -> float:
        return self.value * twist + self._loss * rate


class Play(TwoMasses):
    """Nothing within half the width, stiff flanks beyond; value: the width."""

    _ANGLE = 0.25
    """Phase by which rotor and link swing against each other on a flank in a step: as stiff as the
    step resolves. By the rotor's inertia alone a light link is thrown off."""

    def __init__(self, joint: str, actuator: str, value: float, size: float) -> None:
        super().__init__("backlash", joint, actuator, value, size)

    def torque(self, twist: float, rate: float, step: float) -> float:
        beyond = abs(twist) - self.value / 2
        if beyond <= 0:
            return 0.0
        side = float(np.sign(twist))
        stiff = self._reduced * (self._ANGLE / step) ** 2
        damping = self._reduced * self._ANGLE / step
        return side * max(0.0, stiff * beyond + damping * side * rate)
