"""Offsets that look the same at a position servo, with the numbers at which they do."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from orbisim.effects.base import EffectInstance, index_of, joints_above, names_of_kind


def same_offsets(model: mujoco.MjModel, one: EffectInstance) -> list[EffectInstance]:
    """What moves the readings of a servo's joint as an offset does: of its motor, of its encoder,
    or a force along a slide. Nothing for other effects and without such a servo.

    A servo of gain k with an offset F of its force comes to rest F / k away from its command, and
    one whose encoder reads b too much is reported to. Only what depends on the true position, as
    gravity and contacts do, tells the two apart.
    """
    found: list[EffectInstance] = []
    for joint, torque in _torques(model, one):
        servos = [a for a in range(model.nu) if _moves(model, a, joint)]
        stiffness = _stiffness(model, servos[0]) if len(servos) == 1 else 0.0
        if not stiffness:
            continue
        motor = names_of_kind(model, "actuator")[servos[0]]
        push = torque / float(model.actuator_gear[servos[0], 0])
        name = names_of_kind(model, "joint")[joint]
        found.append(EffectInstance("torque_bias", motor, {"offset": push}))
        found.append(EffectInstance("sensor_bias", name, {"offset": torque / stiffness}))
    return [other for other in found if other.effect != one.effect]


def _torques(model: mujoco.MjModel, one: EffectInstance) -> Iterator[tuple[int, float]]:
    """Joints at which an offset acts, and with what generalized force."""
    if one.effect == "torque_bias":
        motor = index_of(model, "actuator", one.target)
        if model.actuator_trntype[motor] == mujoco.mjtTrn.mjTRN_JOINT:
            gear = float(model.actuator_gear[motor, 0])
            yield int(model.actuator_trnid[motor, 0]), gear * one.values["offset"]
    if one.effect == "sensor_bias" and one.target in names_of_kind(model, "joint"):
        joint = index_of(model, "joint", one.target)
        servos = [a for a in range(model.nu) if _moves(model, a, joint)]
        if len(servos) == 1:
            yield joint, _stiffness(model, servos[0]) * one.values["offset"]
    if one.effect == "constant_force":
        force = np.array([one.values[axis] for axis in "xyz"])
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        for joint in joints_above(model, index_of(model, "body", one.target)):
            along = float(force @ data.xaxis[joint])
            slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
            if slide and abs(along) > _MOSTLY * np.linalg.norm(force):
                yield joint, along


def _moves(model: mujoco.MjModel, actuator: int, joint: int) -> bool:
    """Whether an actuator acts on a joint."""
    at_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
    return bool(at_joint and model.actuator_trnid[actuator, 0] == joint)


def _stiffness(model: mujoco.MjModel, actuator: int) -> float:
    """Torque of a position servo at its joint for a unit of position; 0 if it is none."""
    if model.actuator_biastype[actuator] != mujoco.mjtBias.mjBIAS_AFFINE:
        return 0.0
    gear = float(model.actuator_gear[actuator, 0])
    return -float(model.actuator_biasprm[actuator, 1]) * gear**2


_MOSTLY = 0.9
"""Share of a force that must act along a slide."""
