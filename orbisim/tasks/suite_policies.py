"""Controls for the suite's domains: noise, rhythms, and simple feedback."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

Policy = Callable[[mujoco.MjData], Floats]
"""From the simulation to a control [nu]; called once for each control step, in order."""


def limits(model: mujoco.MjModel) -> tuple[Floats, Floats]:
    """Lowest and highest controls [nu]; -1 and 1 where there is no limit."""
    limited = np.asarray(model.actuator_ctrllimited, bool)
    low = np.where(limited, model.actuator_ctrlrange[:, 0], -1.0)
    return low, np.where(limited, model.actuator_ctrlrange[:, 1], 1.0)


def held(model: mujoco.MjModel, rng: np.random.Generator, step: float) -> Policy:
    """Uniform random controls, each held for a random number of control steps."""
    low, high = limits(model)
    longest = int(rng.integers(1, 16))
    size = rng.uniform(0.3, 1.0)
    left, current = 0, np.zeros(model.nu)

    def policy(data: mujoco.MjData) -> Floats:
        nonlocal left, current
        if left == 0:
            left = int(rng.integers(1, longest + 1))
            current = _scaled(size * rng.uniform(-1, 1, model.nu), low, high)
        left -= 1
        return current

    return policy


def smooth(model: mujoco.MjModel, rng: np.random.Generator, step: float) -> Policy:
    """Ornstein-Uhlenbeck noise with a random correlation time and size."""
    low, high = limits(model)
    decay = float(np.exp(-step / np.exp(rng.uniform(np.log(0.03), np.log(1.0)))))
    size = rng.uniform(0.1, 0.8)
    current = rng.standard_normal(model.nu)

    def policy(data: mujoco.MjData) -> Floats:
        nonlocal current
        current = decay * current + np.sqrt(1 - decay**2) * rng.standard_normal(model.nu)
        return _scaled(size * current, low, high)

    return policy


def rhythm(model: mujoco.MjModel, rng: np.random.Generator, step: float) -> Policy:
    """Sine waves of one frequency with random amplitudes, offsets and phases, a little noise."""
    low, high = limits(model)
    frequency = rng.uniform(0.3, 4.0)
    amplitude, offset = rng.uniform(0.2, 1.0, model.nu), rng.uniform(-0.3, 0.3, model.nu)
    phase = rng.uniform(-np.pi, np.pi, model.nu)

    def policy(data: mujoco.MjData) -> Floats:
        wave = offset + amplitude * np.sin(2 * np.pi * frequency * data.time + phase)
        return _scaled(wave + 0.1 * rng.standard_normal(model.nu), low, high)

    return policy


def reach(model: mujoco.MjModel, rng: np.random.Generator, step: float) -> Policy:
    """Proportional-derivative control of the actuated joints to random targets."""
    low, high = limits(model)
    joints = actuated_joints(model)
    qpos, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    bounds = np.where(model.jnt_limited[joints, None], model.jnt_range[joints], [-np.pi, np.pi])
    stiffness, damping = np.exp(rng.uniform(np.log([0.5, 0.02]), np.log([5.0, 0.5])))
    targets, left = np.zeros(len(joints)), 0

    def policy(data: mujoco.MjData) -> Floats:
        nonlocal targets, left
        if left == 0:
            left = int(rng.integers(10, 80))
            targets = rng.uniform(bounds[:, 0], bounds[:, 1])
        left -= 1
        wanted = stiffness * (targets - data.qpos[qpos]) - damping * data.qvel[dofs]
        return _scaled(_to_actuators(model, joints, wanted), low, high)

    return policy


def actuated_joints(model: mujoco.MjModel) -> npt.NDArray[np.int64]:
    """Slides and hinges that an actuator acts on, directly or through a tendon."""
    found: list[int] = []
    for actuator in range(model.nu):
        target = int(model.actuator_trnid[actuator, 0])
        if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_TENDON:
            first, count = int(model.tendon_adr[target]), int(model.tendon_num[target])
            found += [int(model.wrap_objid[w]) for w in range(first, first + count)]
        else:
            found.append(target)
    return np.array(sorted(set(found)), np.int64)


def _to_actuators(model: mujoco.MjModel, joints: npt.NDArray[np.int64], wanted: Floats) -> Floats:
    """Controls that ask each actuator for the sum of what its joints want."""
    place = {int(joint): i for i, joint in enumerate(joints)}
    control = np.zeros(model.nu)
    for actuator in range(model.nu):
        target = int(model.actuator_trnid[actuator, 0])
        if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_TENDON:
            first, count = int(model.tendon_adr[target]), int(model.tendon_num[target])
            for wrap in range(first, first + count):
                joint, coefficient = int(model.wrap_objid[wrap]), float(model.wrap_prm[wrap])
                control[actuator] += np.sign(coefficient) * wanted[place[joint]]
        else:
            control[actuator] = wanted[place[target]]
    return control


def _scaled(values: Floats, low: Floats, high: Floats) -> Floats:
    """From -1..1 to the range of the controls."""
    return np.clip((low + high) / 2 + values * (high - low) / 2, low, high)


def noisy(policy: Policy, model: mujoco.MjModel, rng: np.random.Generator, size: float) -> Policy:
    """A policy with white noise of a share of the control range added."""
    low, high = limits(model)

    def noised(data: mujoco.MjData) -> Floats:
        noise = size * rng.standard_normal(model.nu) * (high - low) / 2
        return np.clip(policy(data) + noise, low, high)

    return noised
