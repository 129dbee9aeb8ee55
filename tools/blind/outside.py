"""Effects that the catalogue does not have; the diagnosis must not give them a wrong name."""

# ruff: noqa: D102 (overrides are documented in the base class)
from __future__ import annotations

import abc
import dataclasses
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from blind.motion import Motion, inertia_of, rms, torque_of
from orbisim.effects import Hook, StepInputs
from orbisim.effects.base import index_of

Floats = npt.NDArray[np.float64]


class JointHook(Hook, abc.ABC):
    """A force at a joint that `law(position, velocity, time)` gives, each [nworld].

    Attributes:
      repeatable: whether state and time decide about it alone: not by chance, nor by a memory.
    """

    repeatable = True

    def __init__(self, model: mujoco.MjModel, joint: str, values: Mapping[str, float]) -> None:
        super().__init__(values)
        number = index_of(model, "joint", joint)
        self._dof = int(model.jnt_dofadr[number])
        self._q = int(model.jnt_qposadr[number])
        self._step = float(model.opt.timestep)

    def force(self, inputs: StepInputs) -> None:
        inputs.qfrc[:, self._dof] += self.law(
            np.array(inputs.qpos[:, self._q]), np.array(inputs.qvel[:, self._dof]), inputs.time
        )

    @abc.abstractmethod
    def law(self, q: Floats, v: Floats, time: Floats) -> Floats:
        """The force."""


class CubicSpring(JointHook):
    """-k (q - q0)^3."""

    def law(self, q: Floats, v: Floats, time: Floats) -> Floats:
        return -self.value("stiffness") * (q - self.value("rest")) ** 3


class Bristles(JointHook):
    """Hysteresis: bristles of a stiffness that slip at a level (LuGre without Stribeck)."""

    repeatable = False

    def __init__(self, model: mujoco.MjModel, joint: str, values: Mapping[str, float]) -> None:
        super().__init__(model, joint, values)
        self._bend: Floats | None = None

    def law(self, q: Floats, v: Floats, time: Floats) -> Floats:
        level, reach = self.value("level"), self.value("reach")
        bend = np.zeros_like(v) if self._bend is None else self._bend
        # exact for constant v over the step: z' = v - |v| z / reach
        steady = np.sign(v) * reach
        self._bend = steady + (bend - steady) * np.exp(-np.abs(v) / reach * self._step)
        return -level * self._bend / reach


class RandomForce(JointHook):
    """An Ornstein-Uhlenbeck force of a standard deviation and a correlation time."""

    repeatable = False

    def __init__(self, model: mujoco.MjModel, joint: str, values: Mapping[str, float]) -> None:
        super().__init__(model, joint, values)
        self._rng = np.random.default_rng(int(values["seed"]))
        self._now: Floats | None = None

    def law(self, q: Floats, v: Floats, time: Floats) -> Floats:
        size, keep = self.value("size"), np.exp(-self._step / self.value("correlation"))
        if self._now is None:
            self._now = size * self._rng.standard_normal(v.shape)
        kick = size * np.sqrt(1 - keep**2) * self._rng.standard_normal(v.shape)
        self._now = keep * self._now + kick
        return self._now


class FadingTorque(JointHook):
    """A torque A exp(-|v| / vs) in one direction: a brush that lifts off."""

    def law(self, q: Floats, v: Floats, time: Floats) -> Floats:
        return self.value("size") * np.exp(-np.abs(v) / self.value("speed"))


class UnevenFriction(JointHook):
    """Friction whose level changes with the position: F (1 + cos(n q))."""

    def law(self, q: Floats, v: Floats, time: Floats) -> Floats:
        level = self.value("level") * (1 + np.cos(self.value("periods") * q))
        return -level * np.tanh(v / self.value("smooth"))


class OneSidedCord(JointHook):
    """A slack cord with a spring and damper: pulls only beyond a position."""

    def law(self, q: Floats, v: Floats, time: Floats) -> Floats:
        stretch = np.maximum(q - self.value("slack"), 0.0)
        return -self.value("stiffness") * np.sqrt(stretch) - self.value("damping") * v * (
            stretch > 0
        )


class ControlHook(Hook, abc.ABC):
    """A factor on one actuator's control that `gain` gives."""

    repeatable = True

    def __init__(self, model: mujoco.MjModel, actuator: str, values: Mapping[str, float]) -> None:
        super().__init__(values)
        number = index_of(model, "actuator", actuator)
        self._control = int(model.actuator_ctrladr[number])
        joint = int(model.actuator_trnid[number, 0])
        at_joint = model.actuator_trntype[number] == int(mujoco.mjtTrn.mjTRN_JOINT)
        self._q = int(model.jnt_qposadr[joint]) if at_joint else -1

    def control(self, inputs: StepInputs) -> None:
        inputs.ctrl[:, self._control] *= self.gain(inputs)

    @abc.abstractmethod
    def gain(self, inputs: StepInputs) -> Floats:
        """The factor [nworld]."""


class PlaceGain(ControlHook):
    """The gain of the actuator changes with its position: 1 + a sin(n q)."""

    def gain(self, inputs: StepInputs) -> Floats:
        return 1 + self.value("depth") * np.sin(self.value("periods") * inputs.qpos[:, self._q])


class DriftingGain(ControlHook):
    """The gain falls slowly, as a motor or battery warms or empties: 1 - a (1 - exp(-t / T))."""

    def gain(self, inputs: StepInputs) -> Floats:
        return 1 - self.value("depth") * (1 - np.exp(-inputs.time / self.value("time")))


class Gusts(Hook):
    """A random force on a free body in the horizontal plane."""

    repeatable = False

    def __init__(self, model: mujoco.MjModel, body: str, values: Mapping[str, float]) -> None:
        super().__init__(values)
        self._body = index_of(model, "body", body)
        self._step = float(model.opt.timestep)
        self._rng = np.random.default_rng(int(values["seed"]))
        self._now: Floats | None = None

    def force(self, inputs: StepInputs) -> None:
        shape = (len(inputs.time), 2)
        size, keep = self.value("size"), np.exp(-self._step / self.value("correlation"))
        if self._now is None:
            self._now = size * self._rng.standard_normal(shape)
        kick = size * np.sqrt(1 - keep**2) * self._rng.standard_normal(shape)
        self._now = keep * self._now + kick
        inputs.xfrc[:, self._body, :2] += self._now


class Vortex(Hook):
    """A wind that turns about a vertical line: drag against a velocity that depends on place."""

    repeatable = True

    def __init__(self, model: mujoco.MjModel, body: str, values: Mapping[str, float]) -> None:
        super().__init__(values)
        self._body = index_of(model, "body", body)
        self._q = int(model.jnt_qposadr[model.body_jntadr[self._body]])

    def force(self, inputs: StepInputs) -> None:
        x, y = inputs.qpos[:, self._q], inputs.qpos[:, self._q + 1]
        strength = self.value("size")
        inputs.xfrc[:, self._body, 0] -= strength * np.sin(self.value("waves") * y)
        inputs.xfrc[:, self._body, 1] += strength * np.sin(self.value("waves") * x)


@dataclasses.dataclass(frozen=True)
class Outside:
    """An effect outside the catalogue, with values.

    Attributes:
      kind: name of the class. target: joint, actuator or body. values: its numbers.
    """

    kind: str
    target: str
    values: Mapping[str, float]

    def hooks(self, model: mujoco.MjModel) -> list[Hook]:
        """What applies it."""
        return [KINDS[self.kind](model, self.target, self.values)]

    @property
    def repeatable(self) -> bool:
        """Whether a recorded state decides about all that follows."""
        return KINDS[self.kind].repeatable

    def to_json(self) -> dict[str, Any]:
        """For the truth's file."""
        return {"kind": self.kind, "target": self.target, "values": dict(self.values)}


KINDS: Mapping[str, Any] = {
    cls.__name__: cls
    for cls in (
        CubicSpring,
        Bristles,
        RandomForce,
        FadingTorque,
        UnevenFriction,
        OneSidedCord,
        PlaceGain,
        DriftingGain,
        Gusts,
        Vortex,
    )
}


def outside(
    kind: str, motion: Motion, target: str, rng: np.random.Generator, scale: float
) -> Outside:
    """An effect of random size."""
    return Outside(kind, target, _values(kind, motion, target, rng, scale))


def _values(
    kind: str, m: Motion, target: str, rng: np.random.Generator, scale: float
) -> dict[str, float]:
    if kind == "PlaceGain":
        joint = m.model.joint(int(m.model.actuator_trnid[m.actuator(target), 0])).name
        waves = 2 * np.pi * rng.uniform(1.0, 2.0) / float(np.ptp(m.q(joint)))
        return {"depth": min(0.8, scale * rng.uniform(0.2, 0.4)), "periods": waves}
    if kind == "DriftingGain":
        return {"depth": min(0.8, scale * rng.uniform(0.2, 0.4)), "time": rng.uniform(3.0, 6.0)}
    seed = float(rng.integers(2**31))
    if kind in ("Gusts", "Vortex"):
        size = scale * rng.uniform(0.05, 0.15) * 9.81 * m.mass(target)
        if kind == "Vortex":
            return {"size": size, "waves": rng.uniform(4.0, 9.0)}
        return {"size": size, "correlation": rng.uniform(0.1, 0.3), "seed": seed}
    q, torque = m.q(target), torque_of(m, target)
    speed = rms(m.qvel[:, m.dof(target)])
    level = scale * torque
    reach = float(np.ptp(q)) / 2
    if kind == "CubicSpring":
        rest = float(np.median(q))
        return {"stiffness": rng.uniform(0.6, 1.2) * level / reach**3, "rest": rest}
    if kind == "Bristles":
        return {"level": rng.uniform(0.25, 0.5) * level, "reach": rng.uniform(0.15, 0.3) * reach}
    if kind == "RandomForce":
        size = rng.uniform(0.15, 0.3) * level
        return {"size": size, "correlation": rng.uniform(0.1, 0.3), "seed": seed}
    if kind == "FadingTorque":
        return {"size": rng.uniform(0.2, 0.4) * level, "speed": rng.uniform(0.2, 0.5) * speed}
    if kind == "UnevenFriction":
        waves = 2 * np.pi * rng.uniform(2.0, 3.0) / float(np.ptp(q))
        return {"level": rng.uniform(0.2, 0.4) * level, "periods": waves, "smooth": 0.05 * speed}
    slack = float(np.quantile(q, rng.uniform(0.4, 0.6)))
    damping = 0.2 * inertia_of(m, target)
    return {
        "slack": slack,
        "stiffness": rng.uniform(0.4, 0.8) * level / np.sqrt(reach),
        "damping": damping,
    }


PLACES: tuple[tuple[str, str, str], ...] = (
    ("CubicSpring", "arm2", "shoulder"),
    ("CubicSpring", "arm2", "elbow"),
    ("CubicSpring", "arm6", "axis2"),
    ("CubicSpring", "servo_pendulum", "servo"),
    ("CubicSpring", "cart_pole", "cart"),
    ("Bristles", "arm2", "elbow"),
    ("Bristles", "arm6", "axis3"),
    ("Bristles", "servo_pendulum", "servo"),
    ("Bristles", "gripper_push", "x"),
    ("RandomForce", "arm2", "shoulder"),
    ("RandomForce", "arm2", "elbow"),
    ("RandomForce", "arm6", "axis1"),
    ("RandomForce", "cart_pole", "cart"),
    ("RandomForce", "leg", "hip"),
    ("FadingTorque", "arm2", "elbow"),
    ("FadingTorque", "arm6", "axis5"),
    ("FadingTorque", "servo_pendulum", "servo"),
    ("FadingTorque", "cart_pole", "pole"),
    ("UnevenFriction", "arm2", "shoulder"),
    ("UnevenFriction", "arm6", "axis1"),
    ("UnevenFriction", "servo_pendulum", "servo"),
    ("UnevenFriction", "cart_pole", "cart"),
    ("OneSidedCord", "arm2", "elbow"),
    ("OneSidedCord", "arm6", "axis2"),
    ("OneSidedCord", "cart_pole", "cart"),
    ("PlaceGain", "arm2", "shoulder"),
    ("PlaceGain", "arm2", "elbow"),
    ("PlaceGain", "cart_pole", "push"),
    ("DriftingGain", "arm2", "elbow"),
    ("DriftingGain", "arm2", "shoulder"),
    ("DriftingGain", "cart_pole", "push"),
    ("DriftingGain", "drone", "rotor2"),
    ("Gusts", "drone", "drone"),
    ("Gusts", "bouncing_ball", "ball"),
    ("Gusts", "puck", "puck"),
    ("Vortex", "drone", "drone"),
    ("Vortex", "bouncing_ball", "ball"),
    ("Vortex", "puck", "puck"),
)
"""Kind, scene and target of the trials."""
