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
from orbisim.tasks.suite_gaits import GAITS, gait_policy
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
    """Pumps energy through the elbow while it pulls the arm straight, then a regulator."""
    gain = lqr(model, step, np.array([10.0, 10.0, 1.0, 1.0]), 1.0)[0]
    scratch = mujoco.MjData(model)
    top = energy(model, scratch, np.zeros(2), np.zeros(2))

    def policy(data: mujoco.MjData) -> Floats:
        q = np.array([wrap(float(a)) for a in data.qpos])
        v = np.array(data.qvel)
        wanted = -float(gain @ np.concatenate([q, v]))
        if np.abs(q).max() < 0.45 and abs(wanted) < 15.0:
            return np.array([wanted])
        missing = top - energy(model, scratch, q, v)
        return np.array([-0.73 * q[1] - 0.1 * v[1] + 0.5 * missing * v[1]])

    return policy


def energy(model: mujoco.MjModel, scratch: mujoco.MjData, qpos: Floats, qvel: Floats) -> float:
    """Potential and kinetic energy of a state, J."""
    scratch.qpos[:], scratch.qvel[:] = qpos, qvel
    mujoco.mj_kinematics(model, scratch)
    mujoco.mj_comPos(model, scratch)
    mujoco.mj_crb(model, scratch)
    mujoco.mj_energyPos(model, scratch)
    mujoco.mj_energyVel(model, scratch)
    return float(scratch.energy.sum())


def _point_mass(model: mujoco.MjModel, step: float) -> Policy:
    """Drives the mass to the middle."""

    def policy(data: mujoco.MjData) -> Floats:
        force = -20.0 * np.array(data.qpos) - 5.0 * np.array(data.qvel)
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


def _gait(domain: str) -> Maker:
    return lambda model, step: gait_policy(GAITS[domain], model)


_MAKERS: dict[str, Maker] = {
    "pendulum": _pendulum,
    "cartpole": _cartpole,
    "acrobot": _acrobot,
    "point_mass": _point_mass,
    "reacher": _reacher,
    **{domain: _gait(domain) for domain in GAITS},
}
