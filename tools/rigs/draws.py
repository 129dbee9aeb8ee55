"""Draws the size of a law at its place, once, relative to what the machine usually does."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rigs import bodies, drives, friction, strange
from rigs.excitation import driven, joint_of
from rigs.law import Law, Usual, dof_of, index_of, name_of

Rng = np.random.Generator
Draw = Callable[[Usual, str, Rng], Law]

_LEAST, _MOST = 0.05, 0.6
_FAINT = 0.1
"""So much smaller than what an engineer would look for may a law be: some hardly show."""


def _share(rng: Rng, least: float = _LEAST, most: float = _MOST) -> float:
    """How large, relative to what is usual: log-uniform, down to a tenth of what is worth it."""
    return float(np.exp(rng.uniform(np.log(_FAINT * least), np.log(most))))


def _sign(rng: Rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def coulomb(u: Usual, joint: str, rng: Rng) -> Law:
    size = _share(rng)
    return friction.Coulomb("coulomb_friction", joint, size * u.force_of(joint), size)


def viscous(u: Usual, joint: str, rng: Rng) -> Law:
    size = _share(rng)
    value = size * u.force_of(joint) / u.speed_of(joint)
    return friction.Viscous("viscous_damping", joint, value, size)


def quadratic(u: Usual, joint: str, rng: Rng) -> Law:
    size = _share(rng)
    value = size * u.force_of(joint) / u.speed_of(joint) ** 2
    return friction.Quadratic("quadratic_damping", joint, value, size)


def stribeck(u: Usual, joint: str, rng: Rng) -> Law:
    size, ratio = _share(rng), float(rng.uniform(1.4, 2.2))
    speed = float(rng.uniform(0.05, 0.3)) * u.speed_of(joint)
    return friction.Stribeck(joint, size * u.force_of(joint), size, ratio, speed)


def loaded(u: Usual, joint: str, rng: Rng) -> Law:
    size = _share(rng, 0.05, 0.4)
    return friction.Loaded("load_dependent_friction", joint, size, size)


def spring(u: Usual, joint: str, rng: Rng) -> Law:
    size, (middle, travel) = _share(rng), u.travel_of(joint)
    rest = middle + float(rng.uniform(-0.5, 0.5)) * travel
    return friction.Spring(joint, size * u.force_of(joint) / travel, size, rest)


def rotor(u: Usual, joint: str, rng: Rng) -> Law:
    size = _share(rng)
    value = size * float(u.model.dof_M0[dof_of(u.model, joint)])
    return friction.Rotor("armature", joint, value, size)


def teeth(u: Usual, joint: str, rng: Rng) -> Law:
    size, (_, travel) = _share(rng), u.travel_of(joint)
    periods = max(1, round(float(rng.uniform(2, 5)) * np.pi / travel))
    value = size * u.force_of(joint)
    return friction.Teeth(joint, value, size, periods, float(rng.uniform(-3, 3)))


def stop(u: Usual, joint: str, rng: Rng) -> Law:
    depth, side, (middle, travel) = float(rng.uniform(0.05, 0.35)), _sign(rng), u.travel_of(joint)
    inertia = float(u.model.dof_M0[dof_of(u.model, joint)])
    swing = 2 * np.pi * 30.0  # rad/s: hard, and resolved by the truth's step
    place = middle + side * (1 - depth) * travel
    return friction.Stop(joint, place, depth, side, inertia * swing**2, 0.8 * inertia * swing)


def hum(u: Usual, joint: str, rng: Rng) -> Law:
    size = _share(rng)
    rate, phase = float(rng.uniform(0.7, 6.0)), float(rng.uniform(-3, 3))
    return friction.Hum(joint, size * u.force_of(joint), size, rate, phase)


def crosstalk(u: Usual, joint: str, rng: Rng) -> Law:
    others = [name for name in driven(u) if name != joint]
    other = others[int(rng.integers(len(others)))]
    size = _share(rng)
    value = _sign(rng) * size * u.force_of(joint) / max(u.force_of(other), 1e-9)
    return friction.Crosstalk(joint, other, value, size)


def play(u: Usual, joint: str, rng: Rng) -> Law:
    size, (_, travel) = _share(rng, 0.02, 0.15), u.travel_of(joint)
    return drives.Play(joint, drive_of(u, joint), size * travel, size)


def elastic(u: Usual, joint: str, rng: Rng) -> Law:
    swing = 2 * np.pi * float(rng.uniform(3, 15))
    inertia = float(u.model.dof_M0[dof_of(u.model, joint)])
    damping = float(rng.uniform(0.03, 0.2)) * inertia * swing
    return drives.Elastic(
        joint, drive_of(u, joint), inertia * swing**2, swing / (2 * np.pi), damping
    )


def drive_of(u: Usual, joint: str) -> str:
    number = index_of(u.model, "joint", joint)
    found = [a for a in range(u.model.nu) if joint_of(u.model, a) == number]
    return name_of(u.model, "actuator", found[0])


def gain(u: Usual, drive: str, rng: Rng) -> Law:
    size = _share(rng, 0.03, 0.4)
    return drives.Gain("torque_gain", drive, 1 + _sign(rng) * size, size)


def offset(u: Usual, drive: str, rng: Rng) -> Law:
    size = _share(rng)
    value = _sign(rng) * size * float(u.drive[index_of(u.model, "actuator", drive)])
    return drives.Offset("torque_bias", drive, value, size)


def saturation(u: Usual, drive: str, rng: Rng) -> Law:
    size = float(rng.uniform(0.5, 1.3))
    value = size * float(u.drive[index_of(u.model, "actuator", drive)])
    return drives.Saturation("torque_saturation", drive, value, size)


def deadzone(u: Usual, drive: str, rng: Rng) -> Law:
    size = _share(rng)
    value = 2 * size * float(u.command[index_of(u.model, "actuator", drive)])
    return drives.Deadzone("deadband", drive, value, size)


def lag(u: Usual, drive: str, rng: Rng) -> Law:
    value = _share(rng, 0.005, 0.08)
    return drives.Lag("actuator_lag", drive, value, value)


def delay(u: Usual, drive: str, rng: Rng) -> Law:
    value = _share(rng, 0.004, 0.06)
    return drives.Delay("actuator_delay", drive, value, value)


def load(u: Usual, body: str, rng: Rng) -> Law:
    number, size = index_of(u.model, "body", body), _share(rng, 0.03, 0.5)
    reach = float(np.sqrt(u.model.body_inertia[number].max() / u.model.body_mass[number]))
    place = u.model.body_ipos[number] + rng.uniform(-1, 1, 3) * reach
    return bodies.Load(body, size * float(u.model.body_mass[number]), place, size)


def shift(u: Usual, body: str, rng: Rng) -> Law:
    number, size = index_of(u.model, "body", body), _share(rng, 0.05, 0.5)
    reach = float(np.sqrt(u.model.body_inertia[number].max() / u.model.body_mass[number]))
    offset = rng.normal(size=3)
    return bodies.Shift(body, size * reach * offset / np.linalg.norm(offset), size)


def push(u: Usual, body: str, rng: Rng) -> Law:
    size, way = _share(rng, 0.02, 0.3), rng.normal(size=3)
    vector = size * u.weight_of(body) * way / np.linalg.norm(way)
    return bodies.Push(body, vector, size, "constant_force")


def lift(u: Usual, body: str, rng: Rng) -> Law:
    size = _share(rng, 0.02, 0.3)
    mass = size * float(u.model.body_mass[index_of(u.model, "body", body)])
    return bodies.Lift(body, mass, u.model.opt.gravity, size)


def air(power: int) -> Draw:
    def draw(u: Usual, body: str, rng: Rng) -> Law:
        size = _share(rng)
        speed = max(float(np.linalg.norm(u.speed[:3])) if u.model.nv == 6 else 1.0, 0.3)
        return bodies.Air(body, size * u.weight_of(body) / speed ** (power + 1), size, power)

    return draw


def whirl(u: Usual, body: str, rng: Rng) -> Law:
    size = _share(rng)
    speed, spin = float(np.linalg.norm(u.speed[:3])), float(np.linalg.norm(u.speed[3:6]))
    value = size * u.weight_of(body) / (speed * spin)
    return bodies.Whirl("magnus", body, value, size)


def slope(u: Usual, world: str, rng: Rng) -> Law:
    angle, heading = _share(rng, 0.5, 8.0), float(rng.uniform(-np.pi, np.pi))
    return bodies.Slope(angle, np.array([np.cos(heading), np.sin(heading), 0.0]), angle)


def grip(u: Usual, geom: str, rng: Rng) -> Law:
    size = _sign(rng) * _share(rng, 0.1, 0.6)
    declared = float(u.model.geom_friction[index_of(u.model, "geom", geom), 0])
    return bodies.Grip("sliding_friction", geom, declared * (1 + size), abs(size))


def bouncy(u: Usual, geom: str, rng: Rng) -> Law:
    stiff, ratio = 10 ** float(rng.uniform(3.5, 4.5)), float(rng.uniform(0.05, 0.4))
    value = bodies.rebound(stiff, ratio)
    return bodies.Soft("restitution", geom, value, value, stiff, ratio)


def soft(u: Usual, geom: str, rng: Rng) -> Law:
    stiff = 10 ** float(rng.uniform(2.6, 3.6))
    return bodies.Soft("contact_compliance", geom, stiff, stiff, stiff, 1.0)


def bias(u: Usual, joint: str, rng: Rng) -> Law:
    size = _share(rng, 0.01, 0.2)
    value = _sign(rng) * size * u.travel_of(joint)[1]
    return bodies.Misread("sensor_bias", joint, value, size)


def scale(u: Usual, joint: str, rng: Rng) -> Law:
    size = _share(rng, 0.01, 0.15)
    return bodies.Misread("sensor_scale", joint, 1 + _sign(rng) * size, size)


def lateness(u: Usual, joint: str, rng: Rng) -> Law:
    value = _share(rng, 0.004, 0.05)
    return bodies.Misread("sensor_delay", joint, value, value)


def clock(u: Usual, recording: str, rng: Rng) -> Law:
    size = _share(rng, 0.005, 0.08)
    return bodies.Clock(1 + _sign(rng) * size, size)


def of_kind(kind: type[strange.Nameless]) -> Draw:
    def draw(u: Usual, joint: str, rng: Rng) -> Law:
        middle, travel = u.travel_of(joint)
        size = _share(rng, 0.1, 0.7)
        return kind(joint, size, u.force_of(joint), u.speed_of(joint), middle, travel)

    return draw


def warming(u: Usual, joint: str, rng: Rng) -> Law:
    return strange.WarmingFriction(joint, _share(rng, 0.1, 0.7), u.force_of(joint))


def eccentric(u: Usual, joint: str, rng: Rng) -> Law:
    return strange.EccentricEncoder(joint, _share(rng, 0.01, 0.08))


def derating(u: Usual, drive: str, rng: Rng) -> Law:
    typical = float(u.command[index_of(u.model, "actuator", drive)])
    return strange.Derating(drive, _share(rng, 0.1, 0.6), typical)
