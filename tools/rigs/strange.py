"""Laws that no name of the catalogue stands for."""

# ruff: noqa: D102 (overrides are documented in the base class)
from __future__ import annotations

import zlib

import mujoco
import numpy as np

from rigs.drives import AtDrive
from rigs.friction import AtJoint, Bristles
from rigs.law import Floats, Reading


class Nameless(AtJoint):
    """A law at a joint without a name; `size` times a typical force and speed is its scale."""

    def __init__(
        self, joint: str, size: float, force: float, speed: float, place: float, travel: float
    ) -> None:
        super().__init__("", joint, float("nan"), size)
        self._force, self._speed = size * force, speed
        self._place, self._travel = place, travel


class EddyBrake(Nameless):
    """A brake that fades with speed: 2 F (v/s) / (1 + (v/s)^2), s a third of the usual speed."""

    def force(self, q: float, v: float, time: float) -> float:
        x = v / (0.33 * self._speed)
        return -2 * self._force * x / (1 + x * x)


class Magnet(Nameless):
    """A force towards one place, felt near it only."""

    def force(self, q: float, v: float, time: float) -> float:
        x = (q - self._place) / (0.25 * self._travel)
        return float(-2.3 * self._force * x * np.exp(-x * x))


class SofteningSpring(Nameless):
    """F tanh(4 (q - middle) / travel)."""

    def force(self, q: float, v: float, time: float) -> float:
        return float(-self._force * np.tanh(4 * (q - self._place) / self._travel))


class OneWayDamper(Nameless):
    """Damping in one direction only."""

    def force(self, q: float, v: float, time: float) -> float:
        return -2 * self._force * v / self._speed if v > 0 else 0.0


class RatchetDamper(Nameless):
    """Damping that grows with the fourth root of speed and with position."""

    def force(self, q: float, v: float, time: float) -> float:
        grow = 1 + np.tanh((q - self._place) / (0.5 * self._travel))
        return float(-self._force * grow * np.sign(v) * abs(v / self._speed) ** 0.25)


class Creep(Nameless):
    """A spring in line with a dashpot: it pulls towards where the joint has been (0.4 s)."""

    def begin(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        super().begin(model, data)
        self._anchor = float(data.qpos[self._q])

    def force(self, q: float, v: float, time: float) -> float:
        return -3 * self._force * (q - self._anchor) / self._travel

    def advance(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        share = float(model.opt.timestep) / 0.4
        self._anchor += share * (float(data.qpos[self._q]) - self._anchor)


class RandomTorque(Nameless):
    """Coloured noise with a correlation time of 0.15 s, other at each recording."""

    def begin(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        super().begin(model, data)
        seed = zlib.crc32(data.qpos.tobytes() + data.qvel.tobytes())
        self._rng, self._now = np.random.default_rng(seed), 0.0

    def force(self, q: float, v: float, time: float) -> float:
        return self._now

    def advance(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        keep = float(np.exp(-model.opt.timestep / 0.15))
        fresh = float(self._rng.normal()) * self._force * np.sqrt(1 - keep**2)
        self._now = keep * self._now + fresh


class WarmingFriction(Bristles):
    """Dry friction that falls to a third within each recording, as grease warms up."""

    def __init__(self, joint: str, size: float, force: float) -> None:
        super().__init__("", joint, float("nan"), size)
        self._force = size * force

    def level(self, model: mujoco.MjModel, data: mujoco.MjData, speed: float) -> float:
        return float(self._force * (0.33 + 1.3 * np.exp(-data.time / 2.0)))


class Derating(AtDrive):
    """The drive loses torque in proportion to how much it has worked in the last second."""

    def __init__(self, actuator: str, size: float, typical: float) -> None:
        super().__init__("", actuator, float("nan"), size)
        self._typical = max(typical, 1e-9)

    def begin(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        super().begin(model, data)
        self._heat, self._step = 0.0, float(model.opt.timestep)

    def command(self, time: float, command: Floats) -> None:
        given = float(command[self._index])
        self._heat += self._step * ((given / self._typical) ** 2 - self._heat)
        command[self._index] = given / (1 + self.size * self._heat)


class EccentricEncoder(Reading):
    """An encoder disc that is off its axis: once a turn it reads too much and too little."""

    def __init__(self, joint: str, size: float) -> None:
        super().__init__("", joint, float("nan"), size)

    def read(self, positions: Floats) -> Floats:
        return np.asarray(positions + self.size * np.sin(2 * positions + 0.7))


AT_JOINT = (
    EddyBrake,
    Magnet,
    SofteningSpring,
    OneWayDamper,
    RatchetDamper,
    Creep,
    RandomTorque,
)
