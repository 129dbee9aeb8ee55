"""Effects that are the same physics by another name in a given scene.

Each rule turns an effect into others with which the scene moves in exactly the same way, and gives
nothing where that holds only nearly. Damping is integrated implicitly and drag explicitly: there
the equations of motion are the same, and simulations differ by what the timestep rounds off.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import numpy.typing as npt

from blind import mechanism
from orbisim.effects import EffectInstance

Floats = npt.NDArray[np.float64]

EXACT = 1e-9
"""Relative size below which a number counts as zero."""

POWERS = {"linear_drag": "viscous_damping", "quadratic_drag": "quadratic_damping"}
DAMPINGS = {damping: drag for drag, damping in POWERS.items()}


def identical(truth: EffectInstance, model: mujoco.MjModel) -> list[EffectInstance]:
    """Effects with which the scene moves exactly as with `truth`; `truth` itself is left out.

    - Buoyancy of a body is a constant force upwards at its centre of mass, and the other way round.
    - Where a body moves with a single slide or hinge, drag on it is damping of that joint of the
      same power, with the lever of the centre of mass.
    - Where a body moves with a single slide, a force on it is an offset of the slide's motor; if
      the slide is level and the body touches nothing, a mass more is armature.
    - On the only body of a scene, gravity of another direction is a constant force.
    - An offset of the encoder at the hinge that carries the whole mechanism is a turn of gravity
      about its axis, if nothing else depends on that angle.
    - At a position servo of an upright hinge that carries the whole mechanism, an offset of the
      encoder is one of the motor.
    - Detents are cogging: a motor's or a gear's where there is an actuator, a knob's where not.
    - In a scene with one joint and one control, a delay of the one is a delay of the other.
    """
    return [one for rule in _RULES for one in rule(truth, model)]


def _lift(one: EffectInstance, model: mujoco.MjModel) -> Iterator[EffectInstance]:
    gravity = np.array(model.opt.gravity)
    weight = float(np.linalg.norm(gravity))
    if one.effect == "buoyancy" and weight:
        yield force_on(one.target, -one.values["displaced_mass"] * gravity)
    if one.effect == "constant_force" and weight:
        push = vector_of(one)
        up = float(push @ -gravity) / weight
        if up > 0 and np.linalg.norm(push + up * gravity / weight) <= EXACT * up:
            yield EffectInstance("buoyancy", one.target, {"displaced_mass": up / weight})


def _drag(one: EffectInstance, model: mujoco.MjModel) -> Iterator[EffectInstance]:
    power = 2 if one.effect in ("linear_drag", "viscous_damping") else 3
    if one.effect in POWERS:
        joint = mechanism.only_joint(model, one.target)
        if joint is not None:
            size = one.values["coefficient"] * mechanism.lever(model, one.target, joint) ** power
            yield EffectInstance(POWERS[one.effect], joint, {"coefficient": size})
    if one.effect in DAMPINGS:
        for body in mechanism.moved_only_by(model, one.target):
            reach = mechanism.lever(model, body, one.target)
            if reach > EXACT:
                size = one.values["coefficient"] / reach**power
                yield EffectInstance(DAMPINGS[one.effect], body, {"coefficient": size})


def _offset(one: EffectInstance, model: mujoco.MjModel) -> Iterator[EffectInstance]:
    if one.effect == "constant_force":
        joint = mechanism.only_joint(model, one.target)
        if joint is not None and mechanism.slides(model, joint):
            along = float(vector_of(one) @ mechanism.axis(model, joint))
            for motor, gear in mechanism.motors(model, joint):
                yield EffectInstance("torque_bias", motor, {"offset": along / gear})
    if one.effect == "torque_bias":
        for joint in mechanism.names(model, "joint"):
            for motor, gear in mechanism.motors(model, joint):
                if motor == one.target and mechanism.slides(model, joint):
                    push = one.values["offset"] * gear * mechanism.axis(model, joint)
                    for body in mechanism.moved_only_by(model, joint):
                        yield force_on(body, push)


def _mass(one: EffectInstance, model: mujoco.MjModel) -> Iterator[EffectInstance]:
    if one.effect == "payload":
        joint = mechanism.only_joint(model, one.target)
        if joint and mechanism.level(model, joint) and not mechanism.touches(model, one.target):
            yield EffectInstance("armature", joint, {"inertia": one.values["mass"]})
    if one.effect == "armature" and mechanism.level(model, one.target):
        for body in mechanism.moved_only_by(model, one.target):
            if not mechanism.touches(model, body):  # wherever its centre is
                yield EffectInstance("payload", body, {"mass": one.values["inertia"]})


def _tilt(one: EffectInstance, model: mujoco.MjModel) -> Iterator[EffectInstance]:
    if model.nbody != 2 or model.body_gravcomp[1]:
        return
    gravity, mass = np.array(model.opt.gravity), float(model.body_mass[1])
    name = model.body(1).name
    if one.effect == "gravity_tilt":
        yield force_on(name, mass * (vector_of(one) - gravity))
    if one.effect == "constant_force":
        turned = gravity + vector_of(one) / mass
        if abs(np.linalg.norm(turned) - np.linalg.norm(gravity)) <= EXACT * np.linalg.norm(gravity):
            yield tilt_to(turned, gravity)


def _turned(one: EffectInstance, model: mujoco.MjModel) -> Iterator[EffectInstance]:
    joint = mechanism.cyclic_hinge(model)
    if joint is None:
        return
    gravity, axis = np.array(model.opt.gravity), mechanism.axis(model, joint)
    across = gravity - axis * (axis @ gravity)
    if np.linalg.norm(across) <= EXACT * np.linalg.norm(gravity):
        return  # the angle makes no difference at all
    if one.effect == "sensor_bias" and one.target == joint:
        yield tilt_to(_rotated(gravity, axis, one.values["offset"]), gravity)
    if one.effect == "gravity_tilt":
        tilted = vector_of(one)
        angle = float(np.arctan2(axis @ np.cross(across, tilted), across @ tilted))
        if np.linalg.norm(_rotated(gravity, axis, angle) - tilted) <= 1e-6 * np.linalg.norm(tilted):
            yield EffectInstance("sensor_bias", joint, {"offset": angle})


def _servoed(one: EffectInstance, model: mujoco.MjModel) -> Iterator[EffectInstance]:
    joint = mechanism.cyclic_hinge(model, servo=True)
    if joint is None:
        return
    gravity, motors = np.array(model.opt.gravity), mechanism.motors(model, joint)
    across = gravity - mechanism.axis(model, joint) * (mechanism.axis(model, joint) @ gravity)
    if len(motors) != 1 or np.linalg.norm(across) > EXACT * np.linalg.norm(gravity):
        return
    motor, gear = motors[0]
    stiffness = -gear * float(model.actuator(motor).biasprm[1])
    if stiffness and one.effect == "sensor_bias" and one.target == joint:
        offset = stiffness * one.values["offset"]
        yield EffectInstance("torque_bias", motor, {"offset": offset})
    if stiffness and one.effect == "torque_bias" and one.target == motor:
        offset = one.values["offset"] / stiffness
        yield EffectInstance("sensor_bias", joint, {"offset": offset})


def _late(one: EffectInstance, model: mujoco.MjModel) -> Iterator[EffectInstance]:
    joints, actuators = mechanism.names(model, "joint"), mechanism.names(model, "actuator")
    if model.nv != 1 or model.nu != 1 or len(joints) != 1 or len(actuators) != 1:
        return
    if one.effect == "sensor_delay" and one.target == joints[0]:
        yield EffectInstance("actuator_delay", actuators[0], {"delay": one.values["delay"]})
    if one.effect == "actuator_delay":
        yield EffectInstance("sensor_delay", joints[0], {"delay": one.values["delay"]})


def _wave(one: EffectInstance, model: mujoco.MjModel) -> Iterator[EffectInstance]:
    """A sin(n q + phase) = -A sin(n (q - position)), n = 2 pi / pitch."""
    if one.effect == "cogging":
        n, phase = one.values["periods"], one.values["phase"]
        place = {"pitch": 2 * np.pi / n, "position": (np.pi - phase) / n}
        yield EffectInstance("detent", one.target, {"amplitude": one.values["amplitude"], **place})
    if one.effect == "detent":
        n = 2 * np.pi / one.values["pitch"]
        phase = float(np.angle(np.exp(1j * (np.pi - n * one.values["position"]))))
        wave = {"amplitude": one.values["amplitude"], "periods": n, "phase": phase}
        yield EffectInstance("cogging", one.target, wave)


_RULES = (_lift, _drag, _offset, _mass, _tilt, _turned, _servoed, _late, _wave)


def vector_of(one: EffectInstance) -> Floats:
    """The world-frame vector [3] of an effect that has one."""
    return np.array([one.values[axis] for axis in "xyz"])


def force_on(body: str, push: Floats) -> EffectInstance:
    """A constant force [3], N."""
    values = {"magnitude": float(np.linalg.norm(push)), **_parts(push)}
    return EffectInstance("constant_force", body, values)


def tilt_to(tilted: Floats, gravity: Floats) -> EffectInstance:
    """Another direction [3] of gravity, m/s^2."""
    sine, cosine = np.linalg.norm(np.cross(gravity, tilted)), gravity @ tilted
    angle = float(np.degrees(np.arctan2(sine, cosine)))
    return EffectInstance("gravity_tilt", "world", {"angle": angle, **_parts(tilted)})


def _parts(vector: Floats) -> dict[str, float]:
    return {axis: float(x) for axis, x in zip("xyz", vector, strict=True)}


def _rotated(vector: Floats, axis: Floats, angle: float) -> Floats:
    quat, turned = np.zeros(4), np.zeros(3)
    mujoco.mju_axisAngle2Quat(quat, axis, angle)
    mujoco.mju_rotVecQuat(turned, vector, quat)
    return turned
