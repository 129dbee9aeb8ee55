"""How large an effect is made: parameters in proportion to what the scene does without it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from blind.motion import (
    Motion,
    actuated,
    inertia_of,
    per_speed,
    per_square,
    rms,
    speed_of,
    torque_of,
    weight_of,
)
from orbisim.effects import EffectInstance, find
from orbisim.effects.base import index_of, is_scalar_joint, names_of_kind

Floats = npt.NDArray[np.float64]


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


def _single(name: str, value: str, low: float, high: float, unit: Callable[[Motion, str], float]):
    """An effect with one parameter: a share, between low and high, of a unit."""

    def make(m: Motion, target: str, rng: np.random.Generator, scale: float) -> EffectInstance:
        size = scale * _between(rng, low, high) * unit(m, target)
        return EffectInstance(name, target, {value: size})

    return make


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
    coulomb = scale * _between(rng, 0.05, 0.2) * torque_of(m, joint)
    speed = _between(rng, 0.1, 0.3) * rms(m.qvel[:, m.dof(joint)])
    values = {"coulomb": coulomb, "static": coulomb * rng.uniform(1.6, 2.5), "velocity": speed}
    return EffectInstance("stribeck_friction", joint, values)


def _load(m: Motion, joint: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    kinds = ["actuator", "external"] if actuated(m, joint) else ["external"]
    values = {"coefficient": min(scale * _between(rng, 0.06, 0.25), 0.8)}
    name = "load_dependent_friction"
    return EffectInstance(name, joint, values, {"load": str(rng.choice(kinds))})


def _spring(m: Motion, joint: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    q = m.q(joint)
    stiffness = scale * _between(rng, 0.2, 0.8) * torque_of(m, joint) / (np.std(q) + 1e-9)
    rest = float(rng.uniform(*np.quantile(q, [0.1, 0.9])))
    return EffectInstance("joint_spring", joint, {"stiffness": stiffness, "rest_position": rest})


def _cogging(m: Motion, joint: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    waves = 2 * np.pi * rng.uniform(2.5, 5.0) / np.ptp(m.q(joint))
    if is_scalar_joint(m.model, joint) and m.model.joint(joint).type[0] == 3:
        waves = max(4.0, round(waves))
    values = {
        "amplitude": scale * _between(rng, 0.12, 0.35) * torque_of(m, joint),
        "periods": float(waves),
        "phase": float(rng.uniform(-np.pi, np.pi)),
    }
    return EffectInstance("cogging", joint, values)


def _backlash(m: Motion, joint: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    width = scale * _between(rng, 0.01, 0.04) * float(np.ptp(m.q(joint)))
    return EffectInstance("backlash", joint, {"width": min(width, 0.3)})


def _flexible(m: Motion, joint: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    rate = 2 * np.pi * _between(rng, 4.0, 10.0) / np.sqrt(scale)
    stiffness = inertia_of(m, joint) * rate**2
    damping = 2 * rng.uniform(0.04, 0.15) * inertia_of(m, joint) * rate
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
    by = str(rng.choice(["torque", "position", "velocity"] if actuated(m, other) else
                        ["position", "velocity"]))  # fmt: skip
    source = {
        "torque": torque_of(m, other),
        "position": float(np.std(m.q(other))),
        "velocity": rms(m.qvel[:, m.dof(other)]),
    }[by]
    size = _sign(rng) * scale * _between(rng, 0.1, 0.3) * torque_of(m, joint) / (source + 1e-9)
    options = {"other": other, "by": by}
    return EffectInstance("joint_coupling", joint, {"coefficient": size}, options)


def _bias(m: Motion, actuator: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    size = _sign(rng) * scale * _between(rng, 0.05, 0.25) * rms(m.force[:, m.actuator(actuator)])
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
    size = scale * _between(rng, 0.05, 0.25) * weight_of(m, body)
    return _vector("constant_force", "magnitude", size, body, _direction(m, body, rng, "world"))


def _periodic(m: Motion, target: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    options: Mapping[str, str] = {}
    if target in names_of_kind(m.model, "joint") and is_scalar_joint(m.model, target):
        size = _between(rng, 0.1, 0.35) * torque_of(m, target)
    else:
        size = _between(rng, 0.08, 0.25) * weight_of(m, target)
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
        size = scale * _between(rng, 0.05, 0.25) * weight_of(m, body) / speed_of(m, body) ** power
        return EffectInstance(name, body, {"coefficient": size})

    return make


def _magnus(m: Motion, body: str, rng: np.random.Generator, scale: float) -> EffectInstance:
    spin = rms(np.linalg.norm(m.qvel[:, 3:6], axis=1))
    size = scale * _between(rng, 0.05, 0.2) * weight_of(m, body) / (spin * speed_of(m, body))
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
    _, ratio = find("contact_compliance").parameters(m.model, geom)  # bounces as declared
    values = {"stiffness": stiffness, "damping_ratio": ratio.neutral}
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
    "coulomb_friction": _single("coulomb_friction", "torque", 0.06, 0.3, torque_of),
    "viscous_damping": _single("viscous_damping", "coefficient", 0.06, 0.4, per_speed),
    "quadratic_damping": _single("quadratic_damping", "coefficient", 0.06, 0.4, per_square),
    "stribeck_friction": _stribeck,
    "load_dependent_friction": _load,
    "joint_spring": _spring,
    "armature": _single("armature", "inertia", 0.12, 0.6, inertia_of),
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
