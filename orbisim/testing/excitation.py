"""Motions that make missing effects visible: what to command and where to start, by scene.

A scene with position servos or torque motors gets a multi-sine with slow parts, fast parts, steps
and rests; a flying body with actuators hovers along a path under feedback; a body without any is
thrown. Scenes of some names have motions of their own (`BY_NAME`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError
from orbisim.recording.joints import Joint, Kind, joints
from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]
Feedback = Callable[[Floats, Floats, Floats], Floats]
"""Controls [E, nu] from the reference [E, n], qpos [E, nq] and qvel [E, nv]."""

DURATION = 8.0
"""Of an episode, s."""
THROW = 1.5
"""Of a throw, s."""


@dataclasses.dataclass(frozen=True, eq=False)
class Excitation:
    """Initial states and controls of E episodes.

    Attributes:
      qpos: [E, nq]. qvel: [E, nv].
      reference: [E, T, n], one row for each sampling interval: the controls, or what `feedback`
        makes controls of.
      feedback: a controller that runs at the sampling rate; None if the reference is the controls.
    """

    qpos: Floats
    qvel: Floats
    reference: Floats
    feedback: Feedback | None = None

    def control(self, k: int, qpos: Floats, qvel: Floats) -> Floats:
        """Controls [E, nu] of interval k at the states at its start."""
        row = self.reference[:, k]
        return row if self.feedback is None else self.feedback(row, qpos, qvel)


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """What an excitation is made for.

    Attributes:
      scene: the scene. episodes: their number. count: intervals of an episode.
      rate: intervals per second. rng: source of what is random.
    """

    scene: Scene
    episodes: int
    count: int
    rate: float
    rng: np.random.Generator

    @property
    def model(self) -> mujoco.MjModel:
        """The scene's model."""
        return self.scene.model

    @property
    def time(self) -> Floats:
        """Starts of the intervals [T], s."""
        return np.arange(self.count) / self.rate

    def rest(self) -> tuple[Floats, Floats]:
        """The reference configuration, at rest, of every episode."""
        return np.tile(self.model.qpos0, (self.episodes, 1)), np.zeros(
            (self.episodes, self.model.nv)
        )


def excite(
    scene: Scene,
    *,
    duration: float | None = None,
    rate: float = 100.0,
    episodes: int = 4,
    seed: int = 0,
) -> Excitation:
    """An excitation that suits the scene.

    Args:
      scene: the scene as declared.
      duration: of an episode, s; by default 8, and 1.5 for throws.
      rate: control intervals per second.
      episodes: how many.
      seed: of everything random.

    Raises:
      InputError: the duration, the rate or the number of episodes is not positive, or there is
        nothing to move.
    """
    duration = default_duration(scene) if duration is None else duration
    if not (np.isfinite(duration) and duration > 0 and np.isfinite(rate) and rate > 0):
        raise InputError(f"duration and rate must be positive; got {duration} s, {rate} Hz")
    if episodes < 1:
        raise InputError(f"at least one episode is needed; got {episodes}")
    if not scene.model.nv:
        raise InputError(f"scene {scene.name!r} has no joints to move")
    count = max(1, round(duration * rate))
    plan = Plan(scene, episodes, count, rate, np.random.default_rng(seed))
    maker = BY_NAME.get(scene.name)
    if maker is not None:
        return maker(plan)
    if not scene.model.nu:
        return throw(plan) if _free(scene.model) else swing(plan)
    return hover(plan) if _flies(scene.model) else servo(plan)


def default_duration(scene: Scene) -> float:
    """Duration of an episode, s."""
    return DURATION if scene.model.nu or not _free(scene.model) else THROW


# -- signals ---------------------------------------------------------------------------------------


def program(
    rng: np.random.Generator, count: int, rate: float, fast: float, slow: float = 0.15
) -> Floats:
    """A signal [count] within -1 to 1: a multi-sine that is fast, slow or at rest, and steps.

    Args:
      rng: source of what is random.
      count, rate: samples and samples per second.
      fast, slow: highest and lowest frequency of the multi-sine, Hz.
    """
    clock = np.cumsum(_speeds(rng, count, rate)) / rate
    sines = np.zeros(count)
    for frequency in np.geomspace(slow, fast, 6) * rng.uniform(0.85, 1.15, 6):
        weight = rng.uniform(0.5, 1.0) / np.sqrt(frequency)
        sines += weight * np.sin(2 * np.pi * frequency * clock + rng.uniform(0, 2 * np.pi))
    mixed = 0.65 * sines / max(np.abs(sines).max(), 1e-9) + 0.35 * _steps(rng, count, rate)
    return np.asarray(np.clip(mixed, -1.0, 1.0), np.float64)


def _speeds(rng: np.random.Generator, count: int, rate: float) -> Floats:
    """How fast a program runs [count]: phases of 0.3 to 1.2 s, a fifth of them rests."""
    speeds = np.empty(0)
    while len(speeds) < count:
        speed = rng.choice([0.0, 0.25, 0.6, 1.0, 1.0])
        length = rng.uniform(0.3, 0.7) if speed == 0 else rng.uniform(0.5, 1.2)
        speeds = np.concatenate([speeds, np.full(max(1, round(length * rate)), speed)])
    return _smoothed(speeds[:count], rate, 0.1)


def _steps(rng: np.random.Generator, count: int, rate: float) -> Floats:
    """Levels of 0.5 to 1.5 s between -1 and 1, with transitions of 0.05 s."""
    levels = np.empty(0)
    while len(levels) < count:
        length = max(1, round(rng.uniform(0.5, 1.5) * rate))
        levels = np.concatenate([levels, np.full(length, rng.uniform(-1, 1))])
    return _smoothed(levels[:count], rate, 0.05)


def _smoothed(values: Floats, rate: float, width: float) -> Floats:
    size = max(1, round(width * rate))
    padded = np.concatenate([np.full(size - 1, values[0]), values])
    return np.convolve(padded, np.full(size, 1.0 / size), mode="valid")


def glide(time: Floats, knots: Floats, values: Floats) -> Floats:
    """A path through values [K] at times [K] with smooth starts and stops, at times [T]."""
    row = np.clip(np.searchsorted(knots, time, side="right") - 1, 0, len(knots) - 2)
    s = np.clip((time - knots[row]) / (knots[row + 1] - knots[row]), 0.0, 1.0)
    rise = s**3 * (10 - 15 * s + 6 * s**2)
    return np.asarray(values[row] + rise * (values[row + 1] - values[row]))


# -- servos and motors -----------------------------------------------------------------------------

_REACH = 0.5
"""Part of a control range that is used."""


def servo(plan: Plan) -> Excitation:
    """Every actuator follows a program; servos start where they are told to be.

    Slides that are driven by forces are kept near their start by weak feedback.
    """
    model, rng = plan.model, plan.rng
    reference = np.zeros((plan.episodes, plan.count, model.nu))
    for u in range(model.nu):
        low, high = _control_range(model, u)
        # a servo cannot follow fast motions; a motor's torque may change faster
        fast = 1.0 if is_servo(model, u) else 3.0
        for e in range(plan.episodes):
            signal = program(rng, plan.count, plan.rate, fast)
            reference[e, :, u] = 0.5 * (low + high) + _REACH * 0.5 * (high - low) * signal
    qpos, qvel = _poses(plan)
    _start_at_commands(model, qpos, reference[:, 0])
    return Excitation(qpos, qvel, reference, _centring(model))


def swing(plan: Plan) -> Excitation:
    """Nothing is actuated: it is let go from random poses with random velocities."""
    qpos, qvel = _poses(plan)
    for joint in joints(plan.model):
        if joint.scalar:
            qvel[:, joint.v] = plan.rng.uniform(-1, 1, (plan.episodes, 1))
    return Excitation(qpos, qvel, np.zeros((plan.episodes, plan.count, 0)))


def _control_range(model: mujoco.MjModel, u: int) -> tuple[float, float]:
    if model.actuator_ctrllimited[u] or np.ptp(model.actuator_ctrlrange[u]) > 0:
        low, high = model.actuator_ctrlrange[u]
        return float(low), float(high)
    return -1.0, 1.0


def is_servo(model: mujoco.MjModel, u: int) -> bool:
    """Whether the actuator's force depends on its length: a position servo."""
    return bool(model.actuator_biastype[u] and model.actuator_biasprm[u, 1])


def _driven_joint(model: mujoco.MjModel, u: int) -> Joint | None:
    if model.actuator_trntype[u] != int(mujoco.mjtTrn.mjTRN_JOINT):
        return None
    joint = joints(model)[int(model.actuator_trnid[u, 0])]
    return joint if joint.scalar else None


def _poses(plan: Plan) -> tuple[Floats, Floats]:
    """Random poses about the reference configuration, within joint limits, at rest."""
    model = plan.model
    qpos, qvel = plan.rest()
    for joint in joints(model):
        if not joint.scalar:
            continue
        spread = 0.8 if joint.kind == Kind.HINGE else 0.1
        values = qpos[:, joint.q] + plan.rng.uniform(-spread, spread, (plan.episodes, 1))
        if model.jnt_limited[joint.id]:
            low, high = model.jnt_range[joint.id]
            margin = 0.1 * (high - low)
            values = np.clip(values, low + margin, high - margin)
        qpos[:, joint.q] = values
    return qpos, qvel


def _start_at_commands(model: mujoco.MjModel, qpos: Floats, ctrl: Floats) -> None:
    """Puts the joints of servos where their first commands [E, nu] ask for."""
    for u in range(model.nu):
        joint = _driven_joint(model, u)
        if joint is not None and is_servo(model, u):
            factor = -model.actuator_gainprm[u, 0] / model.actuator_biasprm[u, 1]
            length = (
                factor * ctrl[:, u] + -model.actuator_biasprm[u, 0] / (model.actuator_biasprm[u, 1])
            )
            qpos[:, joint.q.start] = length / model.actuator_gear[u, 0]


def _centring(model: mujoco.MjModel) -> Feedback | None:
    """A weak spring and damper at slides that motors drive; None if there are none."""
    driven = []
    for u in range(model.nu):
        joint = _driven_joint(model, u)
        if joint is not None and joint.kind == Kind.SLIDE and not is_servo(model, u):
            low, high = _control_range(model, u)
            stiffness = 0.5 * (high - low)
            mass = float(model.dof_M0[joint.v.start])
            driven.append((u, joint, stiffness, 0.6 * np.sqrt(stiffness * mass)))
    if not driven:
        return None

    def feedback(reference: Floats, qpos: Floats, qvel: Floats) -> Floats:
        ctrl = reference.copy()
        for u, joint, stiffness, damping in driven:
            away = qpos[:, joint.q.start] - model.qpos0[joint.q.start]
            ctrl[:, u] -= stiffness * away + damping * qvel[:, joint.v.start]
        return ctrl

    return feedback


# -- bodies that fly or slide ----------------------------------------------------------------------


def _free(model: mujoco.MjModel) -> list[Joint]:
    return [joint for joint in joints(model) if joint.kind == Kind.FREE]


def _flies(model: mujoco.MjModel) -> bool:
    """Whether all actuators act at sites of a single free body."""
    sites = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_SITE)
    return bool(model.nu and sites.all() and model.njnt == 1 and _free(model))


def throw(plan: Plan) -> Excitation:
    """Free bodies are thrown: along the ground if they lie on it, through the air otherwise."""
    qpos, qvel = plan.rest()
    size, rng = plan.episodes, plan.rng
    for joint in _free(plan.model):
        q, v = joint.q.start, joint.v.start
        heading = rng.uniform(-np.pi, np.pi, size)
        lies = _lies(plan.model, joint)
        speed = rng.uniform(0.8, 2.5, size) if lies else rng.uniform(0.5, 3.0, size)
        qvel[:, v], qvel[:, v + 1] = speed * np.cos(heading), speed * np.sin(heading)
        if lies:
            qvel[:, v + 5] = rng.uniform(-15, 15, size)
            turn = rng.uniform(-np.pi, np.pi, size)
            qpos[:, q + 3], qpos[:, q + 6] = np.cos(turn / 2), np.sin(turn / 2)
        else:
            qpos[:, q + 2] *= rng.uniform(0.6, 1.4, size)
            qvel[:, v + 2] = rng.uniform(-1.0, 2.0, size)
            qvel[:, v + 3 : v + 6] = rng.uniform(-30, 30, (size, 3))
    return Excitation(qpos, qvel, np.zeros((size, plan.count, plan.model.nu)))


def _lies(model: mujoco.MjModel, joint: Joint) -> bool:
    """Whether the body touches something in the reference configuration (1 mm lower)."""
    data = mujoco.MjData(model)
    data.qpos[joint.q.start + 2] -= 1e-3
    mujoco.mj_forward(model, data)
    touched = {int(model.geom_bodyid[g]) for c in data.contact for g in c.geom}
    return joint.body in touched


def hover(plan: Plan) -> Excitation:
    """A flying body follows a path of a few decimetres under feedback of position and attitude."""
    size, rng = plan.episodes, plan.rng
    reference = np.zeros((size, plan.count, 4))
    for e in range(size):
        for axis, reach in enumerate((0.6, 0.6, 0.4, 0.8)):
            reference[e, :, axis] = reach * program(rng, plan.count, plan.rate, 0.7)
    qpos, qvel = plan.rest()
    joint = _free(plan.model)[0]
    start = qpos[:, joint.q][:, :3].copy()
    reference[:, :, :3] += start[:, None]
    qpos[:, joint.q.start : joint.q.start + 3] = reference[:, 0, :3]
    qvel[:, joint.v] = rng.uniform(-0.3, 0.3, (size, 6))
    return Excitation(qpos, qvel, reference, Pilot(plan.model, joint))


class Pilot:
    """Holds a body with thrusters at a position and heading.

    Args:
      model: of the scene. joint: the free joint of the body.
    """

    STIFFNESS, DAMPING = 6.0, 4.5  # of the position, 1/s^2 and 1/s
    TURN, SPIN = 64.0, 12.0  # of the attitude

    def __init__(self, model: mujoco.MjModel, joint: Joint) -> None:
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        moment = np.zeros((model.nu, model.nv))
        mujoco.mju_sparse2dense(
            moment,
            data.actuator_moment,
            data.moment_rownnz,
            data.moment_rowadr,
            data.moment_colind,
        )
        gains = model.actuator_gainprm[: model.nu, 0]
        wrench = (gains[:, None] * moment)[:, joint.v.start + 2 : joint.v.stop]
        self._allocate = np.linalg.pinv(wrench)  # [4, nu]
        self._mass = float(model.body_subtreemass[joint.body])
        self._inertia = np.array(model.dof_M0[joint.v.start + 3 : joint.v.stop])
        self._gravity = float(np.linalg.norm(model.opt.gravity))
        self._q, self._v = joint.q, joint.v

    def __call__(self, reference: Floats, qpos: Floats, qvel: Floats) -> Floats:
        """Controls [E, nu]; the reference is x, y, z and heading [E, 4]."""
        place, quat = qpos[:, self._q][:, :3], qpos[:, self._q][:, 3:]
        speed, spin = qvel[:, self._v][:, :3], qvel[:, self._v][:, 3:]
        wanted = self.STIFFNESS * (reference[:, :3] - place) - self.DAMPING * speed
        roll, pitch, yaw = _angles(quat)
        ahead = np.cos(yaw) * wanted[:, 0] + np.sin(yaw) * wanted[:, 1]
        left = -np.sin(yaw) * wanted[:, 0] + np.cos(yaw) * wanted[:, 1]
        turn = (reference[:, 3] - yaw + np.pi) % (2 * np.pi) - np.pi
        g = max(self._gravity, 1.0)
        error = np.stack(
            [
                np.clip(-left / g, -0.5, 0.5) - roll,
                np.clip(ahead / g, -0.5, 0.5) - pitch,
                0.3 * turn,
            ],
            axis=1,
        )
        torque = self._inertia * (self.TURN * error - self.SPIN * spin)
        upright = np.clip(np.cos(roll) * np.cos(pitch), 0.5, 1.0)
        thrust = self._mass * (self._gravity + wanted[:, 2]) / upright
        return np.concatenate([thrust[:, None], torque], axis=1) @ self._allocate


def _angles(quat: Floats) -> tuple[Floats, Floats, Floats]:
    """Roll, pitch and yaw of unit quaternions [E, 4]."""
    w, x, y, z = quat.T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    return roll, pitch, np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


# -- scenes with motions of their own --------------------------------------------------------------


def push(plan: Plan) -> Excitation:
    """`gripper_push`: strokes against the box at several speeds, sideways too, with retreats."""
    size, rng, time = plan.episodes, plan.rng, plan.time
    qpos, qvel = plan.rest()
    span = max(plan.count / plan.rate, 1e-3)
    reference = np.zeros((size, plan.count, 2))
    for e in range(size):
        reach = np.cumsum(rng.uniform(0.08, 0.2, 3)) + 0.05
        back = reach - rng.uniform(0.02, 0.06, 3)
        stops = np.stack([reach, reach, back, back], axis=1).ravel()
        lengths = np.stack(
            [rng.uniform(0.5, 1.6, 3), np.full(3, 0.3), np.full(3, 0.4), np.full(3, 0.2)], axis=1
        ).ravel()
        knots = np.concatenate([[0.0, 0.2], 0.2 + np.cumsum(lengths)])
        knots *= span / knots[-1]
        reference[e, :, 0] = glide(time, knots, np.concatenate([[0.0, 0.0], stops]))
        reference[e, :, 1] = 0.06 * program(rng, plan.count, plan.rate, 0.8)
    qpos[:, :2] = reference[:, 0]
    box = next(j for j in joints(plan.model) if j.kind == Kind.FREE)
    q, turn = box.q.start, rng.uniform(-0.3, 0.3, size)
    qpos[:, q + 1] += reference[:, 0, 1] + rng.uniform(-0.02, 0.02, size)
    qpos[:, q] += 0.02
    qpos[:, q + 3], qpos[:, q + 6] = np.cos(turn / 2), np.sin(turn / 2)
    return Excitation(qpos, qvel, reference)


def hop(plan: Plan) -> Excitation:
    """`leg`: hops of several heights, squats, swings in the air and rests."""
    size, rng, time = plan.episodes, plan.rng, plan.time
    reference = np.zeros((size, plan.count, 2))
    for e in range(size):
        knots, knee = [0.0], [1.2]
        while knots[-1] < time[-1] + 1.0:
            low, high = rng.uniform(1.2, 1.7), rng.uniform(0.5, 0.9)
            rise = rng.choice([0.1, 0.14, 0.4])  # two kinds of hop and a squat
            lengths = [rng.uniform(0.3, 0.5), rise, rng.uniform(0.15, 0.3), rng.uniform(0.2, 0.5)]
            knots += list(knots[-1] + np.cumsum(lengths))
            knee += [low, high, low - 0.3, low - 0.3]
        bend = glide(time, np.array(knots), np.array(knee))
        reference[e, :, 1] = bend
        lean = 0.12 * program(rng, plan.count, plan.rate, 0.8)
        reference[e, :, 0] = -0.5 * bend + lean
    qpos, qvel = plan.rest()
    qpos[:, 1:3] = reference[:, 0]
    thigh, shank = qpos[:, 1], qpos[:, 1] + qpos[:, 2]
    height = 0.2 * np.cos(thigh) + 0.2 * np.cos(shank) + 0.02
    qpos[:, 0] = height - 0.42 + rng.uniform(0.0, 0.05, size)
    return Excitation(qpos, qvel, reference)


BY_NAME: Mapping[str, Callable[[Plan], Excitation]] = {"gripper_push": push, "leg": hop}
"""Motions of scenes with these names."""
