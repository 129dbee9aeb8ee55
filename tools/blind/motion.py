"""What a scene does without effects: where they make sense in it, and units to size them in."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import numpy.typing as npt

from blind.scenes import Rig
from orbisim import Recording, Scene
from orbisim.effects import find
from orbisim.effects.base import index_of
from orbisim.recording import bind
from orbisim.testing.excitation import is_servo

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """What the declared scene does in its recordings without any effect.

    Attributes:
      rig, scene: the scene. qpos [N, nq], qvel, qacc [N, nv], ctrl [N, nu].
      torque: [nv] typical size of the generalized force at a degree of freedom.
      force: [N, nactuator] of the actuators.
    """

    rig: Rig
    scene: Scene
    qpos: Floats
    qvel: Floats
    qacc: Floats
    ctrl: Floats
    torque: Floats
    force: Floats

    @property
    def model(self) -> mujoco.MjModel:
        """The scene's model."""
        return self.scene.model

    def q(self, joint: str) -> Floats:
        """Positions [N] of a hinge or slide."""
        return self.qpos[:, int(self.model.jnt_qposadr[index_of(self.model, "joint", joint)])]

    def dof(self, joint: str) -> int:
        """The (first) degree of freedom of a joint."""
        return int(self.model.jnt_dofadr[index_of(self.model, "joint", joint)])

    def control(self, actuator: str) -> Floats:
        """Controls [N] of an actuator."""
        return self.ctrl[:, int(self.model.actuator_ctrladr[self.actuator(actuator)])]

    def actuator(self, name: str) -> int:
        """Number of an actuator."""
        return index_of(self.model, "actuator", name)

    def mass(self, body: str) -> float:
        """Of the body alone, kg."""
        return float(self.model.body_mass[index_of(self.model, "body", body)])

    def extent(self, body: str) -> float:
        """Radius of gyration of the body, m."""
        i = index_of(self.model, "body", body)
        return float(np.sqrt(self.model.body_inertia[i].max() / self.model.body_mass[i]))


def observe(rig: Rig, scene: Scene, recordings: list[Recording]) -> Motion:
    """The motion of clean recordings."""
    model = scene.model
    bound = [bind(one, scene) for one in recordings]
    data = mujoco.MjData(model)
    qacc, torque, force = [], [], []
    for one in bound:
        acceleration = np.gradient(one.qvel, one.time, axis=0)
        for k in range(0, len(one.time), 4):
            data.qpos[:], data.qvel[:], data.qacc[:] = one.qpos[k], one.qvel[k], acceleration[k]
            data.ctrl[:] = one.ctrl[k]
            mujoco.mj_inverse(model, data)
            mujoco.mj_fwdActuation(model, data)
            own = model.dof_M0 * np.abs(acceleration[k])
            torque.append(np.maximum(np.abs(data.qfrc_inverse), 0.3 * own))
            force.append(np.array(data.actuator_force))
        qacc.append(acceleration)
    return Motion(
        rig,
        scene,
        np.concatenate([one.qpos for one in bound]),
        np.concatenate([one.qvel for one in bound]),
        np.concatenate(qacc),
        np.concatenate([one.ctrl for one in bound]),
        np.median(torque, axis=0) + 1e-9,
        np.stack(force),
    )


def targets(effect: str, motion: Motion) -> tuple[str, ...]:
    """Where an effect makes physical sense in a scene; the catalogue decides what is possible."""
    rig, model = motion.rig, motion.model
    known = find(effect).targets(model)
    by_geom = dict(rig.geoms)
    if find(effect).kind == "geom":
        return tuple(t for t in by_geom.get(effect, ()) if t in known)
    if effect in ("payload", "com_offset", "constant_force"):
        return tuple(t for t in rig.bodies if t in known)
    if effect in ("linear_drag", "quadratic_drag"):
        return tuple(t for t in rig.medium if t in known)
    if effect == "magnus":
        return rig.spinning
    if effect == "buoyancy":
        return rig.floating
    if effect == "deadband":  # of a servo's command it would be nonsense: it is an angle
        return tuple(t for t in known if _driven_through_zero(motion, t))
    if effect in ("backlash", "joint_flexibility"):  # needs a motor before it
        return tuple(t for t in known if actuated(motion, t))
    return known


def _driven_through_zero(motion: Motion, actuator: str) -> bool:
    ctrl = motion.control(actuator)
    servo = is_servo(motion.model, motion.actuator(actuator))
    return not servo and bool(ctrl.min() < 0 < ctrl.max())


def actuated(motion: Motion, joint: str) -> bool:
    """Whether an actuator drives the joint."""
    model, number = motion.model, index_of(motion.model, "joint", joint)
    by_joint = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)
    return bool((by_joint & (model.actuator_trnid[:, 0] == number)).any())


def rms(values: Floats) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def torque_of(m: Motion, joint: str) -> float:
    """Typical generalized force at a joint, N*m or N."""
    return float(m.torque[m.dof(joint)])


def per_speed(m: Motion, joint: str) -> float:
    """Damping that would make up the typical force at the typical speed."""
    return torque_of(m, joint) / rms(m.qvel[:, m.dof(joint)])


def per_square(m: Motion, joint: str) -> float:
    """Quadratic damping that would make up the typical force at the typical speed."""
    return torque_of(m, joint) / rms(m.qvel[:, m.dof(joint)]) ** 2


def inertia_of(m: Motion, joint: str) -> float:
    """Of the mass matrix at qpos0, kg*m^2 or kg."""
    return float(m.model.dof_M0[m.dof(joint)])


def weight_of(m: Motion, body: str) -> float:
    """Of the body alone, N."""
    return m.mass(body) * 9.81


def speed_of(m: Motion, body: str) -> float:
    """Typical speed of a body's centre of mass, m/s."""
    model, data = m.model, mujoco.MjData(m.model)
    i, found = index_of(model, "body", body), []
    jacobian = np.zeros((3, model.nv))
    for k in range(0, len(m.qpos), 20):
        data.qpos[:] = m.qpos[k]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_jacBodyCom(model, data, jacobian, None, i)
        found.append(jacobian @ m.qvel[k])
    return rms(np.linalg.norm(found, axis=1)) + 1e-6
