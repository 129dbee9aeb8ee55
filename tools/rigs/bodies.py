"""Bodies, the medium, contacts, and faults of measurement."""

# ruff: noqa: D102 (overrides are documented in the base class)
from __future__ import annotations

import abc

import mujoco
import numpy as np

from rigs.law import Floats, Law, Reading, index_of


class AtBody(Law, abc.ABC):
    """A force at a body's centre of mass that its velocity, its spin and time decide."""

    def begin(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._body = index_of(model, "body", self.target)
        self._six = np.zeros(6)

    @abc.abstractmethod
    def force(self, velocity: Floats, spin: Floats) -> Floats:
        """[3] in the world."""

    def passive(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        frame = mujoco.mjtObj.mjOBJ_BODY  # at the centre of mass, here along the world's axes
        mujoco.mj_objectVelocity(model, data, frame, self._body, self._six, 0)
        push = self.force(self._six[3:], self._six[:3])
        point = data.xipos[self._body]
        mujoco.mj_applyFT(model, data, push, np.zeros(3), point, self._body, data.qfrc_passive)


class Push(AtBody):
    """Always the same force; value: its size."""

    def __init__(self, body: str, vector: Floats, size: float, effect: str) -> None:
        self._vector = np.array(vector, float)
        super().__init__(effect, body, float(np.linalg.norm(vector)), size)

    def ways(self) -> list[Law]:
        return [self._with(vector=axis) for axis in self.value * np.eye(3)]

    def force(self, velocity: Floats, spin: Floats) -> Floats:
        return self._vector


class Lift(Push):
    """The weight of what is displaced, upwards; value: its mass."""

    def __init__(self, body: str, mass: float, gravity: Floats, size: float) -> None:
        super().__init__(body, -mass * np.asarray(gravity), size, "buoyancy")
        self.value = mass

    def ways(self) -> list[Law]:
        return []


class Air(AtBody):
    """-c v |v|^power."""

    def __init__(self, body: str, value: float, size: float, power: int) -> None:
        super().__init__(("linear_drag", "quadratic_drag")[power], body, value, size)
        self._power = power

    def force(self, velocity: Floats, spin: Floats) -> Floats:
        return -self.value * float(np.linalg.norm(velocity)) ** self._power * velocity


class Whirl(AtBody):
    """c (spin x v)."""

    def force(self, velocity: Floats, spin: Floats) -> Floats:
        return self.value * np.cross(spin, velocity)


class Load(Law):
    """A point mass fixed to a body; value: its mass."""

    def __init__(self, body: str, value: float, place: Floats, size: float) -> None:
        super().__init__("payload", body, value, size)
        self._place = np.array(place, float)

    def ways(self) -> list[Law]:
        return [self._with(place=self._place + step) for step in 0.01 * np.eye(3)]

    def tune(self, model: mujoco.MjModel) -> None:
        body = index_of(model, "body", self.target)
        mass, own = float(model.body_mass[body]), model.body_ipos[body].copy()
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, model.body_iquat[body])
        turn = axes.reshape(3, 3)
        about = (turn * model.body_inertia[body]) @ turn.T
        total = mass + self.value
        centre = (mass * own + self.value * self._place) / total
        for part, place in ((mass, own), (self.value, self._place)):
            r = place - centre
            about = about + part * (r @ r * np.eye(3) - np.outer(r, r))
        moments, vectors = np.linalg.eigh(about)
        vectors[:, 2] = np.cross(vectors[:, 0], vectors[:, 1])
        model.body_mass[body], model.body_ipos[body] = total, centre
        model.body_inertia[body] = moments
        mujoco.mju_mat2Quat(model.body_iquat[body], vectors.ravel())


class Shift(Law):
    """The centre of mass is elsewhere; value: how far."""

    def __init__(self, body: str, offset: Floats, size: float) -> None:
        self._offset = np.array(offset, float)
        super().__init__("com_offset", body, float(np.linalg.norm(offset)), size)

    def ways(self) -> list[Law]:
        return [self._with(offset=axis) for axis in self.value * np.eye(3)]

    def tune(self, model: mujoco.MjModel) -> None:
        model.body_ipos[index_of(model, "body", self.target)] += self._offset


class Slope(Law):
    """The machine stands on a slope; value: degrees."""

    def __init__(self, value: float, around: Floats, size: float) -> None:
        super().__init__("gravity_tilt", "world", value, size)
        self._around = np.array(around, float)

    def ways(self) -> list[Law]:
        return [self._with(around=np.cross([0.0, 0.0, 1.0], self._around))]

    def tune(self, model: mujoco.MjModel) -> None:
        quat = np.zeros(4)
        mujoco.mju_axisAngle2Quat(quat, self._around, np.radians(self.value))
        turned = np.zeros(3)
        mujoco.mju_rotVecQuat(turned, model.opt.gravity, quat)
        model.opt.gravity[:] = turned


class Grip(Law):
    """Both sides of a contact have another sliding friction; value: the coefficient."""

    def tune(self, model: mujoco.MjModel) -> None:
        model.geom_friction[:, 0] = self.value


class Soft(Law):
    """Both sides of a contact have another stiffness, 1/s^2, and damping ratio."""

    def __init__(
        self, effect: str, geom: str, value: float, size: float, stiff: float, ratio: float
    ) -> None:
        super().__init__(effect, geom, value, size)
        self._solref = (-stiff, -2 * ratio * np.sqrt(stiff))

    def tune(self, model: mujoco.MjModel) -> None:
        model.geom_solref[:] = self._solref


def rebound(stiff: float, ratio: float) -> float:
    """Speed after over speed before a ball hits such a plane, in plain MuJoCo, without gravity,
    which would hold it down for as long as a soft contact lasts."""
    solref = f"{-stiff} {-2 * ratio * np.sqrt(stiff)}"
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.0002" integrator="implicitfast" gravity="0 0 0"/>
        <worldbody><geom type="plane" size="1 1 1" solref="{solref}"/><body pos="0 0 0.2">
        <joint type="slide" axis="0 0 1"/><geom size="0.05" mass="0.5" solref="{solref}"/>
        </body></worldbody></mujoco>"""
    )
    data, before = mujoco.MjData(model), 2.0
    data.qvel[0] = -before
    for _ in range(5000):
        mujoco.mj_step(model, data)
        if not data.ncon and data.qvel[0] > 0:
            return float(data.qvel[0]) / before
    return 0.0


class Misread(Reading):
    """An encoder with an offset, a wrong scale or a delay."""

    def __init__(self, effect: str, joint: str, value: float, size: float) -> None:
        super().__init__(effect, joint, value, size)
        what = {"sensor_bias": "offset", "sensor_scale": "factor", "sensor_delay": "delay"}
        setattr(self, what[effect], value)


class Clock(Reading):
    """The recording's clock is fast; value: recorded over true time."""

    def __init__(self, value: float, size: float) -> None:
        super().__init__("clock_skew", "recording", value, size)
        self.clock = value
