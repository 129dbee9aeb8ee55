"""A motion as regressions see it, and the force that an effect adds along it, by C MuJoCo.

What an effect offers to a regression is compared with the force that it adds in the simulation:
natively by inverse dynamics of the edited model, by hook from what the hook writes.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import mujoco
import numpy as np

from orbisim import Scene
from orbisim.effects import EffectInstance, add_effects, find
from orbisim.effects.running import HookRunner
from orbisim.effects.screening import BodyMotion, Candidate

ROWS = 12
WAVE = 3.0
"""What stands out in the spectrum, Hz or 1/turn."""


@dataclasses.dataclass
class Motion:
    """`MotionRegressors` of random states; `data` holds MuJoCo's fields for each row."""

    model: mujoco.MjModel
    data: list[mujoco.MjData]
    qacc: np.ndarray

    def __getattr__(self, name: str) -> np.ndarray:
        if name.startswith("_"):
            raise AttributeError(name)
        return np.array([getattr(one, name) for one in self.data], np.float64)

    @property
    def velocity_noise(self) -> np.ndarray:
        return np.full(self.model.nv, 1e-9)

    missing_force = None

    def moment(self, actuator: int) -> np.ndarray:
        found = np.zeros((len(self.data), self.model.nv))
        for row, data in zip(found, self.data, strict=True):
            dense = np.zeros((self.model.nactuator, self.model.nv))
            mujoco.mju_sparse2dense(
                dense, data.actuator_moment, data.moment_rownnz, data.moment_rowadr,
                data.moment_colind,
            )  # fmt: skip
            row[:] = dense[actuator]
        return found

    def control_gain(self, actuator: int) -> np.ndarray:
        return np.full(len(self.data), self.model.actuator_gainprm[actuator, 0])

    def filtered_control(self, control: int, time_constant: float) -> np.ndarray:
        return self.ctrl[:, control] / (1 + time_constant)

    def delayed_control(self, control: int, delay: float) -> np.ndarray:
        return self.ctrl[:, control] - delay

    def body_motion(self, body: int) -> BodyMotion:
        return BodyMotion(**_stacked([_of_body(self.model, one, body) for one in self.data]))

    def spectrum_peaks(self, dof: int, against: str) -> np.ndarray:
        return np.array([WAVE])


def random_motion(model: mujoco.MjModel, rows: int = ROWS, seed: int = 0) -> Motion:
    rng = np.random.default_rng(seed)
    motion = Motion(
        model, [mujoco.MjData(model) for _ in range(rows)], rng.normal(size=(rows, model.nv))
    )
    for index, data in enumerate(motion.data):
        mujoco.mj_integratePos(model, data.qpos, rng.uniform(-0.8, 0.8, model.nv), 1.0)
        data.qvel[:] = rng.normal(size=model.nv)
        data.ctrl[:] = rng.uniform(-1, 1, model.nu)
        data.time = 0.1 + 0.013 * index
        _evaluate(model, data, motion.qacc[index])
    return motion


def added(scene: Scene, motion: Motion, one: EffectInstance) -> np.ndarray:
    """[M, nv]: the generalized force that an effect adds at the given accelerations."""
    if find(one.effect).native:
        return _natively(add_effects(scene, [one]).model, motion)
    return _by_hook(motion, one)


def offered(candidate: Candidate, coefficients: Any) -> np.ndarray:
    """[M, ...]: the columns of a candidate with these coefficients."""
    pairs = zip(candidate.columns, coefficients, strict=True)
    return np.sum([c * column.values for column, c in pairs], axis=0)


def found(candidate: Candidate, coefficients: Any) -> EffectInstance:
    """The effect that a candidate makes of fitted coefficients."""
    values = candidate.solve(np.asarray(coefficients, float))
    assert values is not None
    return EffectInstance(candidate.effect, candidate.target, dict(values), candidate.options)


def _natively(model: mujoco.MjModel, motion: Motion) -> np.ndarray:
    forces = []
    for before, acceleration in zip(motion.data, motion.qacc, strict=True):
        after = mujoco.MjData(model)
        after.qpos[:], after.qvel[:], after.time = before.qpos, before.qvel, before.time
        after.ctrl[:] = before.ctrl
        _evaluate(model, after, acceleration)
        forces.append(_applied(after) - _applied(before))
    return np.array(forces)


def _applied(data: mujoco.MjData) -> np.ndarray:
    """All that acts but M a: zero residual in the equation of motion would need -this."""
    return data.qfrc_actuator - data.qfrc_inverse


def _by_hook(motion: Motion, one: EffectInstance) -> np.ndarray:
    model, effect = motion.model, find(one.effect)
    rows = len(motion.data)
    base = {"dof_frictionloss": np.repeat(model.dof_frictionloss[None], rows, axis=0)}
    applied = {"qfrc_applied": np.zeros((rows, model.nv))}
    applied["xfrc_applied"] = np.zeros((rows, model.nbody, 6))
    runner = HookRunner(model, [effect.hook(model, one)])
    inputs = runner.inputs(lambda name: getattr(motion, name), motion.ctrl, applied, base)
    force = np.array(inputs.qfrc)
    for body in range(1, model.nbody):
        force += motion.body_motion(body).force(inputs.xfrc[:, body, :3])
    for actuator in range(model.nu):
        change = inputs.ctrl[:, actuator] - motion.ctrl[:, actuator]
        force += motion.moment(actuator) * (motion.control_gain(actuator) * change)[:, None]
    if runner.fields:
        level = inputs.fields["dof_frictionloss"] - base["dof_frictionloss"]
        force -= np.sign(motion.qvel) * level
    return force


def _evaluate(model: mujoco.MjModel, data: mujoco.MjData, acceleration: np.ndarray) -> None:
    mujoco.mj_forward(model, data)
    data.qacc[:] = acceleration
    mujoco.mj_inverse(model, data)
    mujoco.mj_rnePostConstraint(model, data)


def _of_body(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> dict[str, np.ndarray]:
    com, spin, origin = (np.zeros((3, model.nv)) for _ in range(3))
    mujoco.mj_jacBodyCom(model, data, com, spin, body)
    mujoco.mj_jacBody(model, data, origin, None, body)
    acceleration = np.zeros(6)
    kind = mujoco.mjtObj.mjOBJ_XBODY
    mujoco.mj_objectAcceleration(model, data, kind, body, acceleration, 0)
    return {
        "com": data.xipos[body].copy(),
        "spin": spin @ data.qvel,
        "velocity": com @ data.qvel,
        "rotation": data.xmat[body].reshape(3, 3).copy(),
        "origin": data.xpos[body].copy(),
        "jac_com": com,
        "jac_origin": origin,
        "jac_spin": spin,
        "acc_origin": acceleration[3:],
        "spin_acc": acceleration[:3],
    }


def _stacked(rows: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}
