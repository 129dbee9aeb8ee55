"""How large an effect is made: parameters in proportion to what the scene does without it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import mujoco
import numpy as np
import numpy.typing as npt

from blind.scenes import Rig
from orbisim import Recording, Scene
from orbisim.effects import EffectInstance, find
from orbisim.effects.base import index_of, is_scalar_joint, names_of_kind
from orbisim.testing.excitation import _is_servo

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
    bound = [one.bind(scene) for one in recordings]
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


# -- targets ---------------------------------------------------------------------------------------


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
        return tuple(t for t in known if _actuated(motion, t))
    return known


def _driven_through_zero(motion: Motion, actuator: str) -> bool:
    ctrl = motion.control(actuator)
    servo = _is_servo(motion.model, motion.actuator(actuator))
    return not servo and bool(ctrl.min() < 0 < ctrl.max())


def _actuated(motion: Motion, joint: str) -> bool:
    model, number = motion.model, index_of(motion.model, "joint", joint)
    by_joint = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)
    return bool((by_joint & (model.actuator_trnid[:, 0] == number)).any())


# -- sizes -----------------------------------------------------------------------------------------

Size = Callable[[Motion, str, np.random.Generator, float], EffectInstance]


def sized(
    effect: str, motion: Motion, target: str, rng: np.random.Generator, scale: float = 1.0
) -> EffectInstance:
    """An effect of random size; `scale` enlarges it beyond the usual."""
    return SIZES[effect](motion, target, rng, scale)


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _off_one(rng: np.random.Generator, low: float, high: float, scale: float) -> float:
    """A factor that is off by a share between `low` and `high`, up or down."""
    share = min(scale * _between(rng, low, high), 0.6)
    return 1 + share if rng.random() < 0.5 else 1 - share


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _single(name: str, value: str, low: float, high: float, unit: Callable[[Motion, str], float]):
    """An effect with one parameter: a share, between low and high, of a unit."""

    def make(m: Motion, target: str, rng: np.random.Generator, scale: float) -> EffectInstance:
        size = scale * _between(rng, low, high) * unit(m, target)
        return EffectInstance(name, target, {value: size})

    return make


def _torque(m: Motion, joint: str) -> float:
    return float(m.torque[m.dof(joint)])


def _per_speed(m: Motion, joint: str) -> float:
    return _torque(m, joint) / _rms(m.qvel[:, m.dof(joint)])


def _per_square(m: Motion, joint: str) -> float:
    return _torque(m, joint) / _rms(m.qvel[:, m.dof(joint)]) ** 2


def _inertia(m: Motion, joint: str) -> float:
    return float(m.model.dof_M0[m.dof(joint)])


def _weight(m: Motion, body: str) -> float:
    return m.mass(body) * 9.81


def _speed(m: Motion, body: str) -> float:
    """Typical speed of a body's centre of mass, m/s."""
    model, data = m.model, mujoco.MjData(m.model)
    i, found = index_of(model, "body", body), []
    jacobian = np.zeros((3, model.nv))
    for k in range(0, len(m.qpos), 20):
        data.qpos[:] = m.qpos[k]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_jacBodyCom(model, data, jacobian, None, i)
        found.append(jacobian @ m.qvel[k])
    return _rms(np.linalg.norm(found, axis=1)) + 1e-6


def _direction(m: Motion, body: str, rng: np.random.Generator, frame: str) -> Floats:
    """A random direction along which the body's centre of mass moves in the world; in the body's
    frame, one in which an offset is felt: not along the only axis of rotation.
    """
    free = np.ones(3)
    if m.rig.planar:
        free[1] = 0.0
    if frame == "world" and body in ("carriage", "cart"):
        free = np.array([1.0, 0.0, 0.0])
    if frame == "world" and body == "hand":
        free = np.array([1.0, 1.0, 0.0])
    if frame == "world" and body == "hip":
        free = np.array([0.0, 0.0, 1.0])
    vector = free * rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def _stribeck(m: Motion, joint: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    coulomb = scale * _between(rng, 0.05, 0.2) * _torque(m, joint)
    speed = _between(rng, 0.1, 0.3) * _rms(m.qvel[:, m.dof(joint)])
    values = {"coulomb": coulomb, "static": coulomb * rng.uniform(1.6, 2.5), "velocity": speed}
    return EffectInstance("stribeck_friction", joint, values)


def _load(m: Motion, joint: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    kinds = ["actuator", "external"] if _actuated(m, joint) else ["external"]
    values = {"coefficient": min(scale * _between(rng, 0.06, 0.25), 0.8)}
    name = "load_dependent_friction"
    return EffectInstance(name, joint, values, {"load": str(rng.choice(kinds))})


def _spring(m: Motion, joint: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    q = m.q(joint)
    stiffness = scale * _between(rng, 0.2, 0.8) * _torque(m, joint) / (np.std(q) + 1e-9)
    rest = float(rng.uniform(*np.quantile(q, [0.1, 0.9])))
    return EffectInstance("joint_spring", joint, {"stiffness": stiffness, "rest_position": rest})


def _cogging(m: Motion, joint: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    waves = 2 * np.pi * rng.uniform(2.5, 5.0) / np.ptp(m.q(joint))
    if is_scalar_joint(m.model, joint) and m.model.joint(joint).type[0] == 3:
        waves = max(4.0, round(waves))
    values = {
        "amplitude": scale * _between(rng, 0.12, 0.35) * _torque(m, joint),
        "periods": float(waves),
        "phase": float(rng.uniform(-np.pi, np.pi)),
    }
    return EffectInstance("cogging", joint, values)


def _backlash(m: Motion, joint: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    width = scale * _between(rng, 0.01, 0.04) * float(np.ptp(m.q(joint)))
    return EffectInstance("backlash", joint, {"width": min(width, 0.3)})


def _flexible(m: Motion, joint: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    rate = 2 * np.pi * _between(rng, 4.0, 10.0) / np.sqrt(scale)
    stiffness = _inertia(m, joint) * rate**2
    damping = 2 * rng.uniform(0.04, 0.15) * _inertia(m, joint) * rate
    values = {"stiffness": stiffness, "damping": damping}
    return EffectInstance("joint_flexibility", joint, values)


def _stop(m: Motion, joint: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    q, side = m.q(joint), _sign(rng)
    inside = min(scale * rng.uniform(0.1, 0.25), 0.45) * np.ptp(q)
    position = q.max() - inside if side > 0 else q.min() + inside
    return EffectInstance("hard_stop", joint, {"position": float(position), "side": side})


def _coupling(m: Motion, joint: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    others = [j for j in find("joint_coupling").targets(m.model) if j != joint]
    other = str(rng.choice(others))
    by = str(rng.choice(["torque", "position", "velocity"] if _actuated(m, other) else
                        ["position", "velocity"]))  # fmt: skip
    source = {
        "torque": _torque(m, other),
        "position": float(np.std(m.q(other))),
        "velocity": _rms(m.qvel[:, m.dof(other)]),
    }[by]
    size = _sign(rng) * scale * _between(rng, 0.1, 0.3) * _torque(m, joint) / (source + 1e-9)
    options = {"other": other, "by": by}
    return EffectInstance("joint_coupling", joint, {"coefficient": size}, options)


def _bias(m: Motion, actuator: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    size = _sign(rng) * scale * _between(rng, 0.05, 0.25) * _rms(m.force[:, m.actuator(actuator)])
    return EffectInstance("torque_bias", actuator, {"offset": size})


def _gain(m: Motion, actuator: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    return EffectInstance("torque_gain", actuator, {"gain": _off_one(rng, 0.1, 0.3, scale)})


def _limit(m: Motion, actuator: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    force = np.abs(m.force[:, m.actuator(actuator)])
    level = float(np.quantile(force, max(0.3, rng.uniform(0.7, 0.85) - 0.1 * (scale - 1))))
    return EffectInstance("torque_saturation", actuator, {"limit": level})


def _dead(m: Motion, actuator: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    share = min(rng.uniform(0.12, 0.3) * scale, 0.6)
    width = 2 * float(np.quantile(np.abs(m.control(actuator)), share))
    kind = str(rng.choice(["shift", "gate"]))
    return EffectInstance("deadband", actuator, {"width": width}, {"kind": kind})


def _lag(m: Motion, actuator: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    return EffectInstance(
        "actuator_lag", actuator, {"time_constant": scale * _between(rng, 0.015, 0.06)}
    )


def _delay(m: Motion, actuator: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    step = float(m.model.opt.timestep)
    delay = max(1, round(scale * _between(rng, 0.01, 0.05) / step)) * step
    return EffectInstance("actuator_delay", actuator, {"delay": delay})


def _payload(m: Motion, body: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    i = index_of(m.model, "body", body)
    spread = 0.7 * m.extent(body) * rng.uniform(-1, 1, 3)
    if m.rig.planar:
        spread[1] = 0.0
    place = m.model.body_ipos[i] + spread
    mass = scale * _between(rng, 0.1, 0.4) * m.mass(body)
    values = {
        "mass": mass,
        **dict(zip(("com_x", "com_y", "com_z"), map(float, place), strict=True)),
    }
    return EffectInstance("payload", body, values)


def _vector(name: str, first: str, size: float, body: str, direction: Floats) -> EffectInstance:
    parts = {a: float(size * d) for a, d in zip("xyz", direction, strict=True)}
    return EffectInstance(name, body, {first: size, **parts})


def _offset(m: Motion, body: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    size = scale * _between(rng, 0.15, 0.5) * m.extent(body)
    return _vector("com_offset", "offset", size, body, _direction(m, body, rng, "body"))


def _push(m: Motion, body: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    size = scale * _between(rng, 0.05, 0.25) * _weight(m, body)
    return _vector("constant_force", "magnitude", size, body, _direction(m, body, rng, "world"))


def _periodic(m: Motion, target: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    options: Mapping[str, str] = {}
    if target in names_of_kind(m.model, "joint") and is_scalar_joint(m.model, target):
        size = _between(rng, 0.1, 0.35) * _torque(m, target)
    else:
        size = _between(rng, 0.08, 0.25) * _weight(m, target)
        axis = str(rng.choice(["x", "y", "z"]))
        options = {a: str(float(a == axis)) for a in "xyz"}
    values = {
        "amplitude": scale * size,
        "frequency": _between(rng, 1.2, 6.0),
        "phase": float(rng.uniform(-np.pi, np.pi)),
    }
    return EffectInstance("periodic_disturbance", target, values, options)


def _tilt(m: Motion, target: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    angle = np.radians(scale * _between(rng, 1.5, 5.0))
    azimuth = rng.choice([0.0, np.pi]) if m.rig.planar else rng.uniform(-np.pi, np.pi)
    size = float(np.linalg.norm(m.model.opt.gravity))
    vector = size * np.array(
        [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), -np.cos(angle)]
    )
    parts = {a: float(v) for a, v in zip("xyz", vector, strict=True)}
    return EffectInstance("gravity_tilt", target, {"angle": float(np.degrees(angle)), **parts})


def _drag(name: str, power: int) -> Size:
    def make(m: Motion, body: str, rng: np.random.Generator, scale: float) -> EffectInstance:
        size = scale * _between(rng, 0.05, 0.25) * _weight(m, body) / _speed(m, body) ** power
        return EffectInstance(name, body, {"coefficient": size})

    return make


def _magnus(m: Motion, body: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    spin = _rms(np.linalg.norm(m.qvel[:, 3:6], axis=1))
    size = scale * _between(rng, 0.05, 0.2) * _weight(m, body) / (spin * _speed(m, body))
    return EffectInstance("magnus", body, {"coefficient": _sign(rng) * size})


def _sliding(m: Motion, geom: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    declared = float(m.model.geom_friction[index_of(m.model, "geom", geom), 0])
    value = max(0.05, declared * _off_one(rng, 0.2, 0.5, scale))
    return EffectInstance("sliding_friction", geom, {"coefficient": value})


def _coefficient(name: str, low: float, high: float) -> Size:
    def make(m: Motion, geom: str, rng: np.random.Generator, scale: float) -> EffectInstance:
        return EffectInstance(name, geom, {"coefficient": scale * _between(rng, low, high)})

    return make


def _anisotropic(m: Motion, geom: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    declared = float(m.model.geom_friction[index_of(m.model, "geom", geom), 0])
    ratio = _between(rng, 0.4, 0.7) if rng.random() < 0.5 else _between(rng, 1.5, 2.2)
    return EffectInstance("anisotropic_friction", geom, {"ratio": ratio, "coefficient": declared})


def _restitution(m: Motion, geom: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    stiffness = min(1e5, 0.1 / float(m.model.opt.timestep) ** 2)
    low, high = (0.45, 0.85) if geom == "ball" else (0.2, 0.6)
    values = {"coefficient": float(rng.uniform(low, high)), "stiffness": stiffness}
    return EffectInstance("restitution", geom, values)


def _compliance(m: Motion, geom: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    stiffness = {"ball": 4000.0, "foot": 700.0}.get(geom, 600.0) * _between(rng, 0.4, 1.6) / scale
    ratio = 0.1 if geom == "ball" else float(rng.uniform(0.5, 1.0))
    values = {"stiffness": stiffness, "damping_ratio": ratio}
    return EffectInstance("contact_compliance", geom, values)


def _adhesion(m: Motion, geom: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    body = int(m.model.geom_bodyid[index_of(m.model, "geom", geom)])
    weight = 9.81 * float(m.model.body_subtreemass[m.model.body_rootid[body]])
    return EffectInstance("adhesion", geom, {"force": scale * _between(rng, 0.3, 1.0) * weight})


def _sensor_bias(m: Motion, joint: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    size = 0.04 * float(np.ptp(m.q(joint))) * _between(rng, 0.4, 1.2) * scale
    return EffectInstance("sensor_bias", joint, {"offset": _sign(rng) * size})


def _sensor_scale(m: Motion, joint: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    return EffectInstance("sensor_scale", joint, {"factor": _off_one(rng, 0.02, 0.06, scale)})


def _sensor_delay(m: Motion, joint: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    return EffectInstance("sensor_delay", joint, {"delay": scale * _between(rng, 0.006, 0.03)})


def _clock(m: Motion, target: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    return EffectInstance("clock_skew", target, {"factor": _off_one(rng, 0.012, 0.04, scale)})


SIZES: Mapping[str, Size] = {
    "coulomb_friction": _single("coulomb_friction", "torque", 0.06, 0.3, _torque),
    "viscous_damping": _single("viscous_damping", "coefficient", 0.06, 0.4, _per_speed),
    "quadratic_damping": _single("quadratic_damping", "coefficient", 0.06, 0.4, _per_square),
    "stribeck_friction": _stribeck,
    "load_dependent_friction": _load,
    "joint_spring": _spring,
    "armature": _single("armature", "inertia", 0.12, 0.6, _inertia),
    "cogging": _cogging,
    "backlash": _backlash,
    "joint_flexibility": _flexible,
    "hard_stop": _stop,
    "joint_coupling": _coupling,
    "torque_gain": _gain,
    "torque_bias": _bias,
    "torque_saturation": _limit,
    "deadband": _dead,
    "actuator_lag": _lag,
    "actuator_delay": _delay,
    "payload": _payload,
    "com_offset": _offset,
    "constant_force": _push,
    "periodic_disturbance": _periodic,
    "linear_drag": _drag("linear_drag", 1),
    "quadratic_drag": _drag("quadratic_drag", 2),
    "magnus": _magnus,
    "buoyancy": _single("buoyancy", "displaced_mass", 0.06, 0.25, lambda m, body: m.mass(body)),
    "gravity_tilt": _tilt,
    "sliding_friction": _sliding,
    "torsional_friction": _coefficient("torsional_friction", 0.005, 0.03),
    "rolling_friction": _coefficient("rolling_friction", 0.005, 0.02),
    "anisotropic_friction": _anisotropic,
    "restitution": _restitution,
    "contact_compliance": _compliance,
    "adhesion": _adhesion,
    "sensor_bias": _sensor_bias,
    "sensor_scale": _sensor_scale,
    "sensor_delay": _sensor_delay,
    "clock_skew": _clock,
}
"""How to size each effect of the catalogue."""
