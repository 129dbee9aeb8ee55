"""What can be drawn at a machine: effects of the catalogue, and laws outside it, by place.

Nothing is enlarged until it shows: how well it does is measured and reported.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from rigs import draws, strange
from rigs.draws import Draw
from rigs.excitation import driven, joint_of, scalar_joints
from rigs.law import Usual, dof_of, index_of, name_of
from rigs.machines import Machine

AT_JOINT: Mapping[str, Draw] = {
    "coulomb_friction": draws.coulomb,
    "viscous_damping": draws.viscous,
    "quadratic_damping": draws.quadratic,
    "stribeck_friction": draws.stribeck,
    "joint_spring": draws.spring,
    "armature": draws.rotor,
    "cogging": draws.teeth,
    "hard_stop": draws.stop,
    "periodic_disturbance": draws.hum,
    "sensor_bias": draws.bias,
    "sensor_scale": draws.scale,
    "sensor_delay": draws.lateness,
}
AT_DRIVEN_JOINT: Mapping[str, Draw] = {
    "load_dependent_friction": draws.loaded,
    "joint_coupling": draws.crosstalk,
}
AT_GEARED_JOINT: Mapping[str, Draw] = {"backlash": draws.play, "joint_flexibility": draws.elastic}
AT_DRIVE: Mapping[str, Draw] = {
    "torque_gain": draws.gain,
    "torque_bias": draws.offset,
    "torque_saturation": draws.saturation,
    "deadband": draws.deadzone,
    "actuator_lag": draws.lag,
    "actuator_delay": draws.delay,
}
AT_BODY: Mapping[str, Draw] = {
    "payload": draws.load,
    "com_offset": draws.shift,
    "constant_force": draws.push,
}
IN_AIR: Mapping[str, Draw] = {
    "linear_drag": draws.air(0),
    "quadratic_drag": draws.air(1),
    "buoyancy": draws.lift,
    "magnus": draws.whirl,
    "constant_force": draws.push,
}
AT_CONTACT: Mapping[str, Draw] = {
    "sliding_friction": draws.grip,
    "restitution": draws.bouncy,
    "contact_compliance": draws.soft,
}


def possible(machine: Machine, u: Usual) -> dict[tuple[str, str], Draw]:
    """What can be drawn at a machine, by effect and target."""
    model, found = u.model, {}
    free = model.nv == 6 and not scalar_joints(model)
    places: list[tuple[Mapping[str, Draw], list[str]]] = [
        (AT_JOINT, _moved(machine, u)),
        (AT_DRIVEN_JOINT, driven(u) if model.nu > 1 else []),
        (AT_GEARED_JOINT, _geared(u)),
        (AT_DRIVE, _drives(machine, u)),
        (AT_BODY, [] if free and machine.name == "served_ball" else _bodies(machine, u)),
        (IN_AIR, _bodies(machine, u) if machine.name == "served_ball" else []),
        (AT_CONTACT, list(machine.contact)),
    ]
    for table, targets in places:
        found |= {(effect, target): table[effect] for effect in table for target in targets}
    if machine.name == "sliding_puck":  # nothing bounces
        found = {key: draw for key, draw in found.items() if key[0] != "restitution"}
    if np.linalg.norm(model.opt.gravity) > 0 and _falls(u):
        found["gravity_tilt", "world"] = draws.slope
        found["clock_skew", "recording"] = draws.clock
    elif not free:
        found["clock_skew", "recording"] = draws.clock
    return found


def _falls(u: Usual) -> bool:
    """Whether gravity's direction is felt: something but hinges about the vertical moves."""
    data = mujoco.MjData(u.model)
    mujoco.mj_forward(u.model, data)
    before = data.qfrc_bias.copy()
    tilted = u.model.opt.gravity.copy()
    try:
        u.model.opt.gravity[:] = tilted + [1.0, 1.0, 0.0]
        mujoco.mj_forward(u.model, data)
        return bool(np.abs(data.qfrc_bias - before).max() > 1e-6)
    finally:
        u.model.opt.gravity[:] = tilted


def _moved(machine: Machine, u: Usual) -> list[str]:
    """Hinges and slides that move in the recordings."""
    names = [name_of(u.model, "joint", j) for j in scalar_joints(u.model)]
    return [n for n in names if n not in machine.left_out and u.speed_of(n) > 1e-3]


_ROTOR = 0.02
"""Share of a joint's inertia that must be declared as armature, so that there is a rotor."""


def _geared(u: Usual) -> list[str]:
    dofs = {name: dof_of(u.model, name) for name in driven(u)}
    return [n for n, d in dofs.items() if u.model.dof_armature[d] > _ROTOR * u.model.dof_M0[d]]


def _drives(machine: Machine, u: Usual) -> list[str]:
    return [
        name_of(u.model, "actuator", a)
        for a in range(u.model.nu)
        if joint_of(u.model, a) is not None
    ]


def _bodies(machine: Machine, u: Usual) -> list[str]:
    left = {index_of(u.model, "joint", name) for name in machine.left_out}
    found = []
    for body in range(1, u.model.nbody):
        joints = {j for j in range(u.model.njnt) if u.model.jnt_bodyid[j] == body}
        if joints and not joints & left and u.model.body_mass[body] > 0:
            found.append(name_of(u.model, "body", body))
    return found


def nameless(machine: Machine, u: Usual) -> dict[tuple[str, str], Draw]:
    """Laws outside the catalogue that can be drawn at a machine."""
    found: dict[tuple[str, str], Draw] = {}
    for joint in _moved(machine, u):
        for kind in strange.AT_JOINT:
            found[kind.__name__, joint] = draws.of_kind(kind)
        found["WarmingFriction", joint] = draws.warming
        found["EccentricEncoder", joint] = draws.eccentric
    for drive in _drives(machine, u):
        found["Derating", drive] = draws.derating
    return found
