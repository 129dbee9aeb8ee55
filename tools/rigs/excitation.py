"""How machines are moved: starts, references, and controllers that read through noise."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np

from rigs.law import Floats, Usual, name_of
from rigs.machines import Machine
from rigs.truth import Controller, Truth

_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """Where a recording begins, and who moves the machine."""

    qpos: Floats
    qvel: Floats
    controller: Controller


def scalar_joints(model: mujoco.MjModel) -> list[int]:
    """Hinges and slides."""
    return [j for j in range(model.njnt) if int(model.jnt_type[j]) in (_HINGE, _SLIDE)]


def joint_of(model: mujoco.MjModel, actuator: int) -> int | None:
    """The joint that an actuator drives directly."""
    if int(model.actuator_trntype[actuator]) != int(mujoco.mjtTrn.mjTRN_JOINT):
        return None
    return int(model.actuator_trnid[actuator, 0])


def driven(usual: Usual) -> list[str]:
    """Joints that actuators drive directly."""
    found = [joint_of(usual.model, a) for a in range(usual.model.nu)]
    return [name_of(usual.model, "joint", j) for j in found if j is not None]


def motion(machine: Machine, truth: Truth, rng: np.random.Generator, noise: float) -> Motion:
    """One recording's start and controller, drawn at random.

    Args:
      noise: standard deviation of what the controller reads, rad or m.
    """
    model = truth.model
    qpos = np.array(machine.start or model.qpos0, float)
    qvel = np.zeros(model.nv)
    if machine.drive == "thrown":
        _throw(machine, model, qpos, qvel, rng)
        return Motion(qpos, qvel, lambda time, q, v: np.zeros(truth.size))
    driven = _driven(truth)
    for joint in scalar_joints(model):
        if model.joint(joint).name not in machine.left_out:
            spread = 0.25 if int(model.jnt_type[joint]) == _HINGE else 0.1
            qpos[model.jnt_qposadr[joint]] += rng.uniform(-1, 1) * spread
            if joint not in driven:  # nobody moves it: it swings
                qvel[model.jnt_dofadr[joint]] += rng.uniform(-1, 1) * 4 * spread
    return Motion(qpos, qvel, _tracking(machine, truth, driven, qpos, rng, noise))


def _throw(
    machine: Machine,
    model: mujoco.MjModel,
    qpos: Floats,
    qvel: Floats,
    rng: np.random.Generator,
) -> None:
    if machine.name == "sliding_puck":
        heading = rng.uniform(-np.pi, np.pi)
        qvel[:2] = rng.uniform(0.8, 2.2) * np.array([np.cos(heading), np.sin(heading)])
        qvel[5] = rng.uniform(-15, 15)
        return
    qvel[:3] = rng.uniform([-1.5, -1.5, 0.0], [1.5, 1.5, 2.0])
    qvel[3:6] = rng.normal(size=3) * (60.0 if machine.name == "served_ball" else 4.0)
    if machine.name == "served_ball":
        qvel[:3] *= 3
    quat = rng.normal(size=4)
    qpos[3:7] = quat / np.linalg.norm(quat)


def _driven(truth: Truth) -> dict[int, int]:
    """Joints that are moved, with the place of their command."""
    model = truth.model
    if truth.applied:
        return {j: int(model.jnt_dofadr[j]) for j in scalar_joints(model)}
    found = {joint_of(model, a): a for a in range(model.nu)}
    return {joint: a for joint, a in found.items() if joint is not None}


def _tracking(
    machine: Machine,
    truth: Truth,
    driven: dict[int, int],
    begin: Floats,
    rng: np.random.Generator,
    noise: float,
) -> Controller:
    """Follows sums of three sines; torques by a loose position loop on what is read."""
    model = truth.model
    joints = list(driven)
    place = np.array([driven[j] for j in joints], int)
    q = np.array([model.jnt_qposadr[j] for j in joints], int)
    v = np.array([model.jnt_dofadr[j] for j in joints], int)
    middle, reach = zip(*(_range(model, j, begin) for j in joints), strict=True)
    rates = 2 * np.pi * rng.uniform(0.15, 1.3, (3, len(joints)))
    phases = rng.uniform(0, 2 * np.pi, (3, len(joints)))
    sizes = rng.uniform(0.2, 0.5, (3, len(joints))) * np.array(reach)
    inertia = model.dof_M0[v]
    swing = 2 * np.pi * 2.2  # the loop's own frequency, rad/s
    gear = np.ones(len(joints)) if truth.applied else model.actuator_gear[place, 0]
    servo = machine.drive == "servo"
    reading = np.random.default_rng(rng.integers(2**32))

    def controller(time: float, qpos: Floats, qvel: Floats) -> Floats:
        wanted = np.array(middle) + (sizes * np.sin(rates * time + phases)).sum(axis=0)
        command = np.zeros(truth.size)
        if servo:
            command[place] = wanted
            return command
        read = qpos[q] + noise * reading.normal(size=len(q))
        # velocities that a controller has are differences of positions, filtered: more noise
        rate = qvel[v] + 20 * noise * reading.normal(size=len(v))
        push = inertia * (swing**2 * (wanted - read) - 1.2 * swing * rate)
        command[place] = push / gear
        return command

    return controller


def _range(model: mujoco.MjModel, joint: int, begin: Floats) -> tuple[float, float]:
    """Middle and half of the travel of a joint's references."""
    most = 0.9 if int(model.jnt_type[joint]) == _HINGE else 0.5
    if not model.jnt_limited[joint]:
        return float(begin[model.jnt_qposadr[joint]]), most
    low, high = model.jnt_range[joint]
    return float((low + high) / 2), float(min(most, 0.35 * (high - low)))
