"""Effects that look alike, and what to record to tell them apart."""

from __future__ import annotations

_PAIRS: tuple[tuple[str, str, str], ...] = (
    ("armature", "payload", "record motion in which gravity loads the joint: reflected inertia has "
     "no weight"),
    ("armature", "joint_flexibility", "excite the joint at several frequencies up to its resonance"),
    ("actuator_lag", "actuator_delay", "record steps of the control at a high sampling rate"),
    ("actuator_lag", "viscous_damping", "record the joint swinging freely with the actuator off"),
    ("actuator_delay", "sensor_delay", "record a second sensor of the same motion, or a free swing: "
     "only a late sensor is late there"),
    ("sensor_delay", "clock_skew", "record a second source of time"),
    ("gravity_tilt", "constant_force", "record several masses or postures: gravity pulls every body, "
     "a force one"),
    ("constant_force", "torque_bias", "record other postures: a force's lever arm changes"),
    ("constant_force", "payload", "record accelerated motion: a payload has inertia"),
    ("torque_bias", "joint_spring", "record other positions: a spring's torque changes with them"),
    ("torque_bias", "sensor_bias", "record the actuator switched off"),
    ("torque_gain", "coulomb_friction", "record both directions at several amplitudes: friction does "
     "not scale with the command"),
    ("torque_gain", "payload", "record a known payload, or the actuator switched off"),
    ("torque_gain", "armature", "record static loads: inertia plays no part there"),
    ("torque_gain", "deadband", "record several amplitudes, small ones too"),
    ("torque_saturation", "torque_gain", "record small and large commands"),
    ("joint_spring", "payload", "record other postures of the joints before, or tilt the base"),
    ("joint_spring", "com_offset", "record other postures of the joints before, or tilt the base"),
    ("coulomb_friction", "stribeck_friction", "record slow motion through zero velocity"),
    ("coulomb_friction", "load_dependent_friction", "record the same motion under other loads"),
    ("coulomb_friction", "backlash", "record the link's side, not only the motor's"),
    ("viscous_damping", "quadratic_damping", "record several speeds"),
    ("viscous_damping", "linear_drag", "record other postures: a drag's lever arm changes"),
    ("linear_drag", "quadratic_drag", "record several speeds"),
    ("quadratic_drag", "magnus", "record flights with and without spin"),
    ("payload", "com_offset", "record other accelerations: a payload adds inertia"),
    ("payload", "buoyancy", "record fast motion: displaced weight has no inertia"),
    ("sliding_friction", "gravity_tilt", "record slides in several directions"),
    ("sliding_friction", "adhesion", "record slides under several loads"),
    ("restitution", "contact_compliance", "record impacts at several speeds and at a high rate"),
    ("sensor_scale", "clock_skew", "record a known length and a known duration"),
    ("sensor_scale", "gravity_tilt", "record a known length"),
    ("periodic_disturbance", "cogging", "record several speeds: cogging follows the position"),
)  # fmt: skip


def advice(one: str, other: str) -> str | None:
    """What to record to tell two effects apart; None if there is no standing advice."""
    for first, second, text in _PAIRS:
        if {one, other} == {first, second}:
            return text
    if one == other:
        return "record motion of each of the two alone"
    return None


def standing(effect: str) -> list[tuple[str, str]]:
    """Effects that are known to look like this one, each with what to record."""
    found = [(b, text) for a, b, text in _PAIRS if a == effect]
    return found + [(a, text) for a, b, text in _PAIRS if b == effect]
