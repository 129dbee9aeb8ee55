"""Fixed feedback policies for domains of the suite: swing-ups, balancing, reaching, gaits.

They are simple, deterministic functions of the state, good enough to collect useful data and to
compare the returns of the same policy under two simulators.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.errors import UnknownNameError
from orbisim.tasks.suite_policies import Policy, limits

Floats = npt.NDArray[np.float64]
Maker = Callable[[mujoco.MjModel, float], Policy]


def feedback(domain: str, model: mujoco.MjModel, step: float) -> Policy:
    """The feedback policy of a domain.

    Args:
      domain: of the suite.
      model: its model.
      step: duration of a control step, s.

    Raises:
      UnknownNameError: there is none for the domain.
    """
    if domain not in _MAKERS:
        raise UnknownNameError("domain with a feedback policy", domain, _MAKERS)
    low, high = limits(model)
    inner = _MAKERS[domain](model, step)
    return lambda data: np.clip(inner(data), low, high)


def has_feedback(domain: str) -> bool:
    """Whether a domain has a feedback policy."""
    return domain in _MAKERS


def wrap(angle: float) -> float:
    """An angle between -pi and pi."""
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def lqr(model: mujoco.MjModel, step: float, weights: Floats, control_weight: float) -> Floats:
    """Gain K [nu, 2 nv] of u = -K x at the upright reference configuration, qpos = 0."""
    from scipy.linalg import solve_discrete_are

    n, eps = 2 * model.nv, 1e-5
    steps = round(step / model.opt.timestep)
    columns = [
        (_after(model, eps * row, steps) - _after(model, -eps * row, steps)) / (2 * eps)
        for row in np.eye(n + model.nu)
    ]
    many, inputs = np.array(columns[:n]).T, np.array(columns[n:]).T
    r = control_weight * np.eye(model.nu)
    p = solve_discrete_are(many, inputs, np.diag(weights), r)
    return np.asarray(np.linalg.solve(r + inputs.T @ p @ inputs, inputs.T @ p @ many))


def _after(model: mujoco.MjModel, start: Floats, steps: int) -> Floats:
    """State (qpos, qvel) some timesteps after a state and control (qpos, qvel, ctrl)."""
    data, nv = mujoco.MjData(model), model.nv
    data.qpos[:], data.qvel[:], data.ctrl[:] = start[:nv], start[nv : 2 * nv], start[2 * nv :]
    mujoco.mj_step(model, data, steps)
    return np.concatenate([data.qpos, data.qvel])


def _pendulum(model: mujoco.MjModel, step: float) -> Policy:
    """Pumps energy until the pole is near the top, then holds it there."""
    data = mujoco.MjData(model)
    data.qpos[0] = np.pi / 2
    mujoco.mj_forward(model, data)
    weight = abs(float(data.qfrc_bias[0]))  # torque of gravity on the level pole
    inertia = float(data.M[0])
    gain = lqr(model, step, np.array([10.0, 1.0]), 1.0)[0]

    def policy(data: mujoco.MjData) -> Floats:
        angle, speed = wrap(float(data.qpos[0])), float(data.qvel[0])
        if abs(angle) < 0.25 and abs(speed) < 2.0:
            return np.array([-(gain @ [angle, speed])])
        missing = weight * (1 - np.cos(angle)) - 0.5 * inertia * speed**2
        return np.array([np.sign(missing) * (1.0 if speed >= 0 else -1.0)])

    return policy


def _cartpole(model: mujoco.MjModel, step: float) -> Policy:
    """Energy swing-up with the cart drawn to the middle, then a linear regulator."""
    gain = lqr(model, step, np.array([1.0, 10.0, 0.1, 0.1])[: 2 * model.nv], 0.1)[0]

    def policy(data: mujoco.MjData) -> Floats:
        x, v = float(data.qpos[0]), float(data.qvel[0])
        angle, speed = wrap(float(data.qpos[1])), float(data.qvel[1])
        if abs(angle) < 0.4 and abs(speed) < 3.0:
            return np.array([-(gain @ [x, angle, v, speed])])
        energy = 0.5 * speed**2 / 14.7 + np.cos(angle) - 1.0  # in units of weight times length
        pump = 1.5 * np.clip(energy, -1, 1) * np.sign(speed * np.cos(angle))
        return np.array([pump - 0.5 * x - 0.2 * v])

    return policy


def _acrobot(model: mujoco.MjModel, step: float) -> Policy:
    """Pumps by moving the lower arm with the upper arm's swing (Spong 1995), then a regulator."""
    gain = lqr(model, step, np.array([10.0, 10.0, 1.0, 1.0]), 1.0)[0]

    def policy(data: mujoco.MjData) -> Floats:
        q = np.array([wrap(float(a)) for a in data.qpos])
        v = np.array(data.qvel)
        if abs(q[0]) < 0.2 and abs(q[1]) < 0.3 and np.abs(v).max() < 2.0:
            return -(gain @ np.concatenate([q, v]))[None]
        wanted = 1.2 * np.arctan(2.0 * v[0])
        return np.array([4.0 * (wanted - q[1]) - 0.5 * v[1]])

    return policy


def _point_mass(model: mujoco.MjModel, step: float) -> Policy:
    """Drives the mass to the middle."""

    def policy(data: mujoco.MjData) -> Floats:
        force = -4.0 * np.array(data.qpos) - 1.5 * np.array(data.qvel)
        axes = np.array([_tendon_row(model, i) for i in range(model.nu)])
        return np.linalg.solve(axes, force)

    return policy


def _tendon_row(model: mujoco.MjModel, actuator: int) -> Floats:
    row = np.zeros(model.nv)
    tendon = int(model.actuator_trnid[actuator, 0])
    first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    for wrapped in range(first, first + count):
        row[model.jnt_dofadr[model.wrap_objid[wrapped]]] = model.wrap_prm[wrapped]
    return row


def _reacher(model: mujoco.MjModel, step: float) -> Policy:
    """Pulls the finger to the target by the transposed Jacobian."""
    finger, target = int(model.geom("finger").id), int(model.geom("target").id)
    jacobian = np.zeros((3, model.nv))
    scratch = mujoco.MjData(model)

    def policy(data: mujoco.MjData) -> Floats:
        scratch.qpos[:] = data.qpos
        mujoco.mj_kinematics(model, scratch)
        mujoco.mj_comPos(model, scratch)
        body = int(model.geom_bodyid[finger])
        mujoco.mj_jac(model, scratch, jacobian, None, scratch.geom_xpos[finger], body)
        way = scratch.geom_xpos[target] - scratch.geom_xpos[finger]
        return 15.0 * jacobian.T @ way - 0.3 * np.array(data.qvel)

    return policy


def _gait(
    frequency: float, amplitude: tuple[float, ...], phase: tuple[float, ...], damping: float
) -> Maker:
    def make(model: mujoco.MjModel, step: float) -> Policy:
        size, shift = np.array(amplitude), np.array(phase)

        def policy(data: mujoco.MjData) -> Floats:
            wave = size * np.sin(2 * np.pi * frequency * data.time + shift)
            return wave - damping * np.array(data.qvel[-model.nu :])

        return policy

    return make


_MAKERS: dict[str, Maker] = {
    "pendulum": _pendulum,
    "cartpole": _cartpole,
    "acrobot": _acrobot,
    "point_mass": _point_mass,
    "reacher": _reacher,
    "finger": _gait(1.5, (1.0, 1.0), (0.0, 1.3), 0.02),
    "cheetah": _gait(2.5, (1.0, 0.8, 0.6, 0.9, 0.8, 0.6), (0, 0.8, 1.6, 3.0, 3.8, 4.6), 0.02),
    "hopper": _gait(1.5, (0.2, 0.5, 0.9, 0.5), (0.0, 0.6, 1.9, 2.6), 0.02),
    "walker": _gait(1.2, (0.8, 0.6, 0.4, 0.8, 0.6, 0.4), (0, 1.2, 2.0, 3.14, 4.34, 5.14), 0.02),
}
