"""Recordings prepared for diagnosis: a reference motion close to the measured one, and what the
measurements say relative to it.

The state of the real system is x = xbar + xi, where xbar is the smoothed measurement. Everything
that follows is linear in the small deviation xi, so that the quality of the smoothing matters only
to second order.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.effects.base import Extent
from orbisim.errors import RecordingError
from orbisim.recording import Bound, Recording, bind, estimate_motion, noise_std
from orbisim.recording.actuators import actuators
from orbisim.recording.binding import held_inputs
from orbisim.recording.command_clock import Lead, Periods, command_clock, command_periods
from orbisim.recording.gaps import LONGEST, Bridged
from orbisim.recording.initial import activations, histories, starts
from orbisim.recording.joints import Kind, joints
from orbisim.recording.noise import lattice_step
from orbisim.recording.thinning import Thinned
from orbisim.recording.zero_order_hold import Held, led
from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int64]


@dataclasses.dataclass(frozen=True, eq=False)
class Samples:
    """One recording, row by row.

    Attributes:
      bound: the recording in the scene's order.
      time: [T], s.
      qpos: [T, nq], qvel: [T, nv], qacc: [T, nv]: the reference motion.
      ctrl: [T, nu]. act: [T, na]. history: [T, nhistory]. force: [T, nv] recorded joint forces that
        drive the scene, zero elsewhere.
      dq: [T, nv] measured minus reference position in the tangent space, NaN where not measured.
      dv: [T, nv] measured minus reference velocity, NaN where not measured.
      q_noise, v_noise: [nv] standard deviations of the measurements; NaN where there are none.
      rounding: [2 nv] standard deviations of what rounding to a sensor's steps leaves (over the
        root of 12 of them); 0 where values lie on no lattice.
      usable: [T] whether the reference is known.
      jumps: [T - 1, nv] whether the velocity jumped (an impact) between two samples.
      lead: [T - 1] each, by what share of an interval controls, and forces, change before the
        sample that logs them; None where all change at their samples. `ctrl` and `force` are means
        over the interval that follows each sample then.
      driven: [T] whether controls and forces from each sample to the next are known, also where
        they change up to an interval earlier or later than logged (`Lead`); not in gaps.
      between: controls and forces as they are held between the samples, where more is known of
        them (`Thinned`); else None. `ctrl` and `force` are means then, too.
    """

    bound: Bound
    time: Floats
    qpos: Floats
    qvel: Floats
    qacc: Floats
    ctrl: Floats
    act: Floats
    history: Floats
    force: Floats
    dq: Floats
    dv: Floats
    q_noise: Floats
    v_noise: Floats
    rounding: Floats
    usable: Bools
    jumps: Bools
    driven: Bools
    lead: tuple[Floats, Floats] | None = None
    between: tuple[Held, Held] | None = None

    def __len__(self) -> int:
        return len(self.time)

    @functools.cached_property
    def absolute(self) -> Floats:
        """[T, 2 nv]: reference positions and velocities of hinges, slides and the translations of
        free joints, each at its degree of freedom; zero for rotations."""
        model = self.bound.model
        out = np.zeros((len(self), 2 * model.nv))
        for joint in joints(model):
            width = 1 if joint.scalar else 3 if joint.kind == Kind.FREE else 0
            q, v = joint.q.start, joint.v.start
            out[:, v : v + width] = self.qpos[:, q : q + width]
            out[:, model.nv + v : model.nv + v + width] = self.qvel[:, v : v + width]
        return out

    @functools.cached_property
    def qacc_std(self) -> Floats:
        """[T, nv]: standard deviation of the smoothed acceleration by measurement noise."""
        return np.nan_to_num(estimate_motion(self.bound).qacc_std)

    def led(self, lead: Lead) -> Samples:
        """With controls and forces that change before the samples that log them."""
        signals = self.bound.ctrl, _applied(self.bound)
        ctrl, force = (lead.shares(self.time, values) for values in signals)
        led = dataclasses.replace(self, lead=(ctrl, force))
        if isinstance(self.bound.recording, Thinned):
            every = held_inputs(self.bound.recording.whole, self.bound)
            moved = tuple(held.moved(lead.shares(held.time, held.values)) for held in every)
            led = dataclasses.replace(led, between=(moved[0], moved[1]))
        ctrl, force = (values[:, 0] for values in led.inputs(1))
        return dataclasses.replace(led, ctrl=ctrl, force=force)

    def inputs(self, parts: int) -> tuple[Floats, Floats]:
        """Means of controls [T, parts, nu] and forces [T, parts, nv] over equal parts of the
        interval that follows each sample."""
        if self.between is not None:
            ctrl, force = (_within(held, self.time, parts) for held in self.between)
            return ctrl, force
        signals = self.bound.ctrl, _applied(self.bound)
        none = np.zeros(len(self) - 1)
        ctrl, force = map(led, signals, self.lead or (none, none), (parts, parts))
        return ctrl, force

    @functools.cached_property
    def command_periods(self) -> Periods | None:
        """What periods the clock may have by which controls, or forces, change; None if none
        shows."""
        periods = (command_periods(self.time, v) for v in (self.bound.ctrl, _applied(self.bound)))
        return next((one for one in periods if one is not None), None)

    def clocked(self, period: float) -> bool:
        """Whether controls, or forces, change by a clock of such a period, s."""
        signals = self.bound.ctrl, _applied(self.bound)
        return any(command_clock(self.time, values, period) is not None for values in signals)

    @property
    def source(self) -> str:
        """Name of the recording."""
        return self.bound.recording.source


def _within(held: Held, time: Floats, parts: int) -> Floats:
    """[T, parts, n]: means over equal parts of the interval that follows each sample; the last
    sample's is as long as the one before."""
    length = np.diff(time, append=2 * time[-1] - time[-2])
    return held.within(time[:, None] + length[:, None] * np.linspace(0.0, 1.0, parts + 1))


def prepare(recording: Recording, scene: Scene) -> Samples:
    """Smooths a recording and relates it to a scene.

    Raises:
      RecordingError: it does not fit the scene, or the state is nowhere known.
    """
    bound = bind(recording, scene)
    motion = estimate_motion(bound)
    first = starts(bound, "smoothed", motion)
    qpos = np.where(np.isfinite(motion.qpos), motion.qpos, first.qpos)
    (qpos, qvel), qacc = _with_spin(bound, qpos, first.qvel), np.nan_to_num(motion.qacc)
    usable = np.isfinite(qpos).all(axis=1) & np.isfinite(qvel).all(axis=1)
    if usable.sum() < 3:
        raise RecordingError(
            recording.source,
            "the state is known at fewer than three samples",
            remedy="record all joint positions over a stretch of time",
        )
    reference = dataclasses.replace(first, qpos=qpos, qvel=qvel)
    rows = np.flatnonzero(usable)
    act = np.zeros((len(bound.time), scene.model.na))
    history = np.zeros((len(bound.time), scene.model.nhistory))
    if act.shape[1]:
        act[rows] = activations(bound, reference, rows)
    if history.shape[1]:
        history[rows] = histories(bound, rows)
    dq, dv = _deviations(bound, qpos, qvel)
    return Samples(
        bound=bound,
        time=bound.time,
        qpos=qpos,
        qvel=qvel,
        qacc=qacc,
        ctrl=bound.ctrl,
        act=act,
        history=history,
        force=_applied(bound),
        dq=dq,
        dv=dv,
        q_noise=_floor(motion.noise_std, dq),
        v_noise=_velocity_noise(bound),
        rounding=_rounding(bound),
        usable=np.asarray(usable),
        jumps=motion.jumps,
        driven=_driven(recording),
        between=held_inputs(recording.whole, bound) if isinstance(recording, Thinned) else None,
    )


def _driven(recording: Recording) -> Bools:
    """[T]: see `Samples.driven`."""
    every = recording.whole if isinstance(recording, Thinned) else recording
    step = np.diff(every.time)
    gaps = every.time[:-1][step > (LONGEST + 1.5) * np.median(step)]
    unknown = np.searchsorted(recording.time, gaps, side="right") - 1
    if isinstance(every, Bridged):
        at = np.searchsorted(recording.time, every.unknown, side="right") - 1
        unknown = np.append(unknown, at[:, None] + np.arange(-1, 2))
    driven = np.ones(len(recording), bool)
    driven[unknown[(unknown >= 0) & (unknown < len(driven))]] = False
    return driven


def _applied(bound: Bound) -> Floats:
    """[T, nv]: recorded joint forces that drive the scene."""
    return np.where(bound.applied, np.nan_to_num(bound.torque), 0.0)


def _with_spin(bound: Bound, qpos: Floats, qvel: Floats) -> tuple[Floats, Floats]:
    """Positions and velocities with the recorded spin of spheres whose orientation is not recorded.

    Their orientation follows from the spin; where it starts does not matter.
    """
    qpos, qvel = qpos.copy(), qvel.copy()
    for joint in joints(bound.model):
        if joint.id not in bound.unseen_turns or joint.angular is None or joint.quat is None:
            continue
        known = np.flatnonzero(np.isfinite(bound.qvel[:, joint.angular]).all(axis=1))
        if not len(known):
            continue
        nearest = np.abs(bound.time[:, None] - bound.time[known]).argmin(axis=1)
        qvel[:, joint.angular] = bound.qvel[known[nearest], joint.angular]
        turned = qpos[0, joint.quat].copy()
        for row, step in enumerate(np.diff(bound.time)):
            mujoco.mju_quatIntegrate(turned, qvel[row, joint.angular], step)
            qpos[row + 1, joint.quat] = turned
    return qpos, qvel


def prepare_all(recordings: Sequence[Recording], scene: Scene) -> list[Samples]:
    """Prepares several recordings; noise levels are pooled over them."""
    prepared = [prepare(recording, scene) for recording in recordings]
    q_noise = _pooled([one.q_noise for one in prepared])
    v_noise = _pooled([one.v_noise for one in prepared])
    rounding = np.max([one.rounding for one in prepared], axis=0)
    known = {"q_noise": q_noise, "v_noise": v_noise, "rounding": rounding}
    return [dataclasses.replace(one, **known) for one in prepared]


def _rounding(bound: Bound) -> Floats:
    found = np.zeros((2, bound.model.nv))
    for joint in joints(bound.model):
        straight = joint.scalar or joint.kind == Kind.FREE
        for k in range((1 if joint.scalar else 3) if straight else 0):
            v = joint.v.start + k
            found[0, v] = _lattice(bound.qpos[:, joint.q.start + k])
            found[1, v] = _lattice(bound.qvel[:, v])
    return found.ravel() / np.sqrt(12.0)


def _lattice(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(lattice_step(known)) if len(known) > _FEWEST and np.ptp(known) else 0.0


_FEWEST = 8
"""Values of which the step between two levels of a quantiser can be told."""


def _pooled(levels: list[Floats]) -> Floats:
    stacked = np.stack(levels)
    known = np.isfinite(stacked)
    total = np.where(known, stacked, 0.0) ** 2
    count = known.sum(axis=0)
    return np.where(count > 0, np.sqrt(total.sum(axis=0) / np.maximum(count, 1)), np.nan)


def _deviations(bound: Bound, qpos: Floats, qvel: Floats) -> tuple[Floats, Floats]:
    model = bound.model
    dq = np.full((len(qpos), model.nv), np.nan)
    known = np.isfinite(qpos).all(axis=1) & np.isfinite(bound.qpos).all(axis=1)
    row = np.zeros(model.nv)
    for t in np.flatnonzero(known):
        mujoco.mj_differentiatePos(model, row, 1.0, qpos[t], bound.qpos[t])
        dq[t] = row
    for joint in joints(model):
        partly = np.isfinite(bound.qpos[:, joint.q]).all(axis=1) & ~known
        if joint.scalar:
            dq[partly, joint.v] = (bound.qpos - qpos)[partly, joint.q]
        if joint.id not in bound.measured:
            dq[:, joint.v] = np.nan
        if joint.id in bound.unseen_turns and joint.angular is not None:
            dq[:, joint.angular] = np.nan
    return dq, bound.qvel - qvel


def _floor(noise: Floats, dq: Floats) -> Floats:
    """Noise levels, not below what floating point and smoothing leave."""
    measured = np.isfinite(dq).any(axis=0)
    return np.where(measured, np.maximum(np.nan_to_num(noise), 1e-9), np.nan)


_CONSTANT = 0.01
"""How well a velocity that never changes is taken to be known, relative."""


def _velocity_noise(bound: Bound) -> Floats:
    found = np.full(bound.model.nv, np.nan)
    for column in range(bound.model.nv):
        values = bound.qvel[:, column]
        known = values[np.isfinite(values)]
        if len(known) < 8:
            continue
        found[column] = max(float(noise_std(bound.time, values)), 1e-9)
        if not np.ptp(known):  # one estimate for all samples
            found[column] = max(found[column], _CONSTANT * abs(known[0]))
    return found


def parts_of(samples: Sequence[Samples], substeps: int) -> int:
    """Into how many parts, over which inputs are constant, intervals of so many timesteps fall:
    into all, where some inputs change within."""
    return substeps if any(one.lead or one.between for one in samples) else 1


def substeps(duration: npt.ArrayLike, timestep: float) -> Ints:
    """Timesteps within durations [...], s: none is longer than declared by more than 5 %, so that a
    clock which is a little fast, or jitters, does not cost another one (where bodies touch, what a
    step does depends on its length)."""
    return np.asarray(
        np.maximum(1, np.ceil(np.asarray(duration) / (_LONGER * timestep) - 1e-6)), np.int64
    )


_LONGER = 1.05
"""Times the timestep that a step may last, rather than be cut into two of about half of it."""


def extent(samples: Sequence[Samples]) -> Extent:
    """How far recordings go."""
    longest = max(float(one.time[-1] - one.time[0]) for one in samples)
    nv = samples[0].absolute.shape[1] // 2
    state = np.concatenate([one.absolute[one.usable] for one in samples])
    speed = np.sqrt(np.mean(state[:, nv:] ** 2, axis=0))
    low, high = state[:, :nv].min(axis=0), state[:, :nv].max(axis=0)
    return Extent(longest, high - low, np.asarray(speed), (low + high) / 2)


def forces_known(scene: Scene, samples: Sequence[Samples]) -> bool:
    """Whether every degree of freedom is driven by a recorded force, or by an actuator whose force
    follows from its recorded control alone."""
    model, recorded = scene.model, {name for one in samples for name in one.bound.recording.signals}
    driven = np.zeros(model.nv, bool)
    for one in samples:
        driven |= np.asarray(one.bound.applied, bool)
    for actuator in actuators(model):
        plain = model.actuator_biastype[actuator.id] == mujoco.mjtBias.mjBIAS_NONE
        known = not recorded.isdisjoint(("ctrl", f"ctrl/{actuator.name}"))
        if known and actuator.driven and actuator.joint >= 0 and plain and not model.na:
            driven[model.jnt_dofadr[actuator.joint]] = True
    return bool(driven.all())
