"""From what happened to what is logged: encoders, clocks, commands and currents as they are."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np

from rigs.excitation import scalar_joints
from rigs.law import Floats, Law, Reading, index_of, name_of
from rigs.truth import Run

ARTEFACTS = (
    "coloured",
    "encoder",
    "filtered_velocity",
    "jitter",
    "host_stamps",
    "late_commands",
    "slow_commands",
    "dropped",
    "sensor_delays",
    "positions_only",
    "current_torque",
)
"""What recordings have beside white noise."""

COUNTS = 4096
"""Of an encoder, per turn; of a slide, per 0.2 m (a belt on a pulley of 32 mm)."""


JITTER = 0.01
"""Of a sampling interval, by which samples are taken beside their times (standard deviation)."""


@dataclasses.dataclass(frozen=True, eq=False)
class Chain:
    """A measuring chain, the same for all recordings of a trial.

    Attributes:
      noise: of positions, rad or m. rate: of samples, Hz. artefacts: of `ARTEFACTS`.
      velocities: whether they are logged. delays: [njnt] of the joints' signals, s.
      late: of commands, s. tick: between commands, s. seed: of everything random.
    """

    noise: float
    rate: float
    artefacts: tuple[str, ...]
    velocities: bool
    delays: Floats
    late: float
    tick: float
    seed: int

    def unknown(self, speeds: Floats) -> Floats:
        """[T, nv] standard deviation of a position at its time, from how fast it changes: samples
        that are taken beside their times are off by as much as it has moved."""
        jitter = JITTER / self.rate if "jitter" in self.artefacts else 0.0
        return np.hypot(self.noise, jitter * speeds)

    def ticks(self, duration: float, rng: np.random.Generator) -> Floats:
        """When commands are computed."""
        begin = 0.0
        if "slow_commands" in self.artefacts:
            begin = -float(rng.uniform(0, self.tick))
        return np.arange(begin, duration, self.tick)


def drawn(
    model: mujoco.MjModel,
    rate: float,
    artefacts: Sequence[str],
    rng: np.random.Generator,
) -> Chain:
    """A chain with these artefacts; how bad each is, is drawn."""
    # everything is drawn whether it is used or not, so that an artefact changes nothing else
    noise = float(np.exp(rng.uniform(np.log(1e-4), np.log(2e-3))))
    late, tick = float(rng.uniform(0.2, 0.9)) / rate, float(rng.uniform(2.2, 3.8)) / rate
    velocities = bool(rng.random() < 0.5) or "filtered_velocity" in artefacts
    seed = int(rng.integers(2**32))
    delays = rng.uniform(0.001, 0.008, model.njnt)
    return Chain(
        noise,
        rate,
        tuple(artefacts),
        velocities and "positions_only" not in artefacts,
        delays if "sensor_delays" in artefacts else np.zeros(model.njnt),
        late if "late_commands" in artefacts else 0.0,
        tick if "slow_commands" in artefacts else 1 / rate,
        seed,
    )


def logged(
    run: Run,
    model: mujoco.MjModel,
    chain: Chain,
    laws: Sequence[Law],
    number: int,
    applied: bool,
) -> dict[str, Floats]:
    """The signals of a recording, by their names in the file.

    Args:
      number: of the recording. applied: whether torques are logged instead of commands.
    """
    rng = np.random.default_rng([chain.seed, number])
    step = 1 / chain.rate
    grid = np.arange(2, int(float(run.time[-1]) * chain.rate)) * step  # of the commands
    taken, stamps = _clock(grid, chain, rng)
    qpos, qvel = seen(run, model, chain, laws, taken)
    noise = _noise(chain, qpos.shape, rng)
    positions = _noisy_positions(model, qpos, noise, chain)
    found = {"time": stamps * _fast(laws)}
    if applied:
        for joint in range(model.njnt):
            name = name_of(model, "joint", joint)
            found[f"qpos/{name}"] = positions[:, joint]
    else:
        found["qpos"] = positions
    if chain.velocities:
        rates = _velocities(qvel, positions, model, chain, stamps, rng)
        if applied:
            for joint in range(model.njnt):
                found[f"qvel/{name_of(model, 'joint', joint)}"] = rates[:, joint]
        else:
            found["qvel"] = rates
    _commands(found, run, model, chain, grid, rng, applied)
    kept = _kept(len(taken), chain, rng)
    return {name: values[kept] for name, values in found.items()}


def _clock(nominal: Floats, chain: Chain, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """When samples are taken, and what is logged as their time."""
    if "jitter" in chain.artefacts:
        return nominal + JITTER / chain.rate * rng.normal(size=len(nominal)), nominal
    if "host_stamps" in chain.artefacts:
        # a bus and a scheduler: 2 ms on average, with a tail; never out of order
        arrive = nominal + rng.gamma(2.0, 0.001, len(nominal))
        least = 1e-6 * np.arange(len(arrive))  # apart, where they would be out of order
        return nominal, np.maximum.accumulate(arrive - least) + least
    return nominal, nominal


def seen(
    run: Run, model: mujoco.MjModel, chain: Chain, laws: Sequence[Law], at: Floats
) -> tuple[Floats, Floats]:
    """Positions and velocities of the encoders at times [T], without noise."""
    late = _delays(model, laws) + chain.delays
    qpos, qvel = np.empty((len(at), model.nq)), np.empty((len(at), model.nv))
    for joint in range(model.njnt):
        q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        wide = {0: (7, 6), 1: (4, 3)}.get(int(model.jnt_type[joint]), (1, 1))
        when = at - late[joint]
        for i in range(q, q + wide[0]):
            qpos[:, i] = np.interp(when, run.time, run.qpos[:, i])
        for i in range(v, v + wide[1]):
            qvel[:, i] = np.interp(when, run.time, run.qvel[:, i])
        if wide == (7, 6):
            qpos[:, q + 3 : q + 7] /= np.linalg.norm(qpos[:, q + 3 : q + 7], axis=1)[:, None]
    for law in laws:
        if isinstance(law, Reading) and law.target != "recording":
            joint = index_of(model, "joint", law.target)
            q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
            tiny = 1e-6
            slope = (law.read(qpos[:, q] + tiny) - law.read(qpos[:, q] - tiny)) / (2 * tiny)
            qpos[:, q], qvel[:, v] = law.read(qpos[:, q]), slope * qvel[:, v]
    return qpos, qvel


def _delays(model: mujoco.MjModel, laws: Sequence[Law]) -> Floats:
    found = np.zeros(model.njnt)
    for law in laws:
        if isinstance(law, Reading) and law.delay:
            found[index_of(model, "joint", law.target)] += law.delay
    return found


def _fast(laws: Sequence[Law]) -> float:
    return float(np.prod([law.clock for law in laws if isinstance(law, Reading)]))


def _noise(chain: Chain, shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    white = rng.normal(size=shape)
    size = chain.noise
    if "encoder" in chain.artefacts:
        size = min(size, 1e-4)  # the rounding is the noise
    if "coloured" not in chain.artefacts:
        return size * white
    keep = float(np.exp(-1 / (chain.rate * 0.03)))  # correlated over 30 ms
    found = np.empty(shape)
    found[0] = white[0]
    for k in range(1, len(white)):
        found[k] = keep * found[k - 1] + np.sqrt(1 - keep**2) * white[k]
    return size * found


def _noisy_positions(model: mujoco.MjModel, qpos: Floats, noise: Floats, chain: Chain) -> Floats:
    found = qpos.copy()
    for joint in range(model.njnt):
        q, kind = int(model.jnt_qposadr[joint]), int(model.jnt_type[joint])
        if kind == int(mujoco.mjtJoint.mjJNT_FREE):
            found[:, q : q + 3] += noise[:, q : q + 3]
            for k in range(len(qpos)):
                mujoco.mju_quatIntegrate(found[k, q + 3 : q + 7], 2 * noise[k, q + 3 : q + 6], 1.0)
        else:
            found[:, q] += noise[:, q]
            if "encoder" in chain.artefacts:
                hinge = kind == int(mujoco.mjtJoint.mjJNT_HINGE)
                count = (2 * np.pi if hinge else 0.2) / COUNTS
                found[:, q] = count * np.round(found[:, q] / count)
    return found


def _velocities(
    qvel: Floats,
    positions: Floats,
    model: mujoco.MjModel,
    chain: Chain,
    stamps: Floats,
    rng: np.random.Generator,
) -> Floats:
    if "filtered_velocity" not in chain.artefacts or len(scalar_joints(model)) < model.njnt:
        return qvel + 20 * chain.noise * rng.normal(size=qvel.shape)
    # differences of what was read, through a low-pass of 15 Hz: late, as they are on machines
    keep = float(np.exp(-2 * np.pi * 15 / chain.rate))
    found = np.empty_like(qvel)
    raw = np.diff(positions, axis=0, prepend=positions[:1]) * chain.rate
    found[0] = qvel[0]
    for k in range(1, len(raw)):
        found[k] = keep * found[k - 1] + (1 - keep) * raw[k]
    return found


def _commands(
    found: dict[str, Floats],
    run: Run,
    model: mujoco.MjModel,
    chain: Chain,
    grid: Floats,
    rng: np.random.Generator,
    applied: bool,
) -> None:
    """What was sent last on the grid of the samples, and torques: a sensor that is read a little
    beside it does not change what a cycle has sent."""
    rows = np.clip(np.searchsorted(run.time, grid + 1e-9, side="right") - 1, 0, None)
    torques = run.sent[rows] if applied else run.drive[rows]
    if not applied and run.sent.shape[1]:
        found["ctrl"] = run.sent[rows]
    if not applied and "current_torque" not in chain.artefacts:
        return
    if "current_torque" in chain.artefacts:
        # a current sensor of 3 % noise, filtered at 60 Hz, with ripple of the commutation
        keep = float(np.exp(-2 * np.pi * 60 / chain.rate))
        torques = torques.copy()
        for k in range(1, len(torques)):
            torques[k] = keep * torques[k - 1] + (1 - keep) * torques[k]
        typical = np.sqrt(np.mean(torques**2, axis=0))
        torques = torques + 0.03 * typical * rng.normal(size=torques.shape)
        torques = torques * (1 + 0.01 * np.sin(40 * run.qpos[rows][:, :1]))
    for joint in scalar_joints(model):
        dof = int(model.jnt_dofadr[joint])
        if applied or np.any(run.drive[:, dof]):
            found[f"torque/{name_of(model, 'joint', joint)}"] = torques[:, dof]


def _kept(count: int, chain: Chain, rng: np.random.Generator) -> Floats:
    kept = np.ones(count, bool)
    if "dropped" in chain.artefacts:
        kept &= rng.random(count) > 0.03
        begin = int(rng.integers(count // 4, count // 2))
        kept[begin : begin + 8] = False
    return np.flatnonzero(kept)
