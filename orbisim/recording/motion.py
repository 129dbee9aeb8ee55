"""The motion behind a recording: smoothed positions, velocities and accelerations."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping

import numpy as np
import numpy.typing as npt

from orbisim.recording import quaternions as quat
from orbisim.recording.bound import Bound
from orbisim.recording.joints import Joint, Kind, joints
from orbisim.recording.noise import noise_std
from orbisim.recording.smoothing import Smoothed, smooth, smoothed

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]


@dataclasses.dataclass(frozen=True, eq=False)
class SmoothedRotation:
    """A smoothed orientation.

    Attributes:
      quat: [T, 4] unit quaternions w x y z.
      angvel, angacc: [T, 3] angular velocity and acceleration in the body's frame, rad/s, rad/s^2.
      angle_std, angvel_std, angacc_std: [T] standard deviations of each component.
      noise_std: standard deviation of the measurement noise about each axis, rad.
      jumps: [T - 1] whether the angular velocity jumped between a sample and the next.
    """

    quat: Floats
    angvel: Floats
    angacc: Floats
    angle_std: Floats
    angvel_std: Floats
    angacc_std: Floats
    noise_std: float
    jumps: Bools


def stated_noise(bound: Bound, joint: Joint) -> tuple[Floats, Floats]:
    """Noise of a joint's position and orientation, each [3], m or rad, as its recording states it.

    `metadata["noise"]` holds standard deviations by the names of signals (as `orbisim infer` writes
    them), one for all components of a position or turns about all axes of the body, or one for
    each: a fit to images errs alike from frame to frame, and where nothing moves it repeats itself,
    so that the samples alone look better than they are. 0 where nothing is stated.
    """
    given = bound.recording.metadata.get("noise")
    if not isinstance(given, Mapping):
        return np.zeros(3), np.zeros(3)
    body = bound.model.body(joint.body).name

    def largest(*names: str) -> Floats:
        known = [given.get(name) for name in names if name in bound.recording.signals]
        return np.asarray(np.max([np.zeros(3), *(_each_axis(stated) for stated in known)], axis=0))

    return largest(f"qpos/{joint.name}", f"xpos/{body}"), largest(f"xquat/{body}")


def _each_axis(stated: object) -> Floats:
    """[3] of what a recording's metadata say; 0 where that is no number."""
    try:
        numbers = np.broadcast_to(np.asarray(stated, np.float64), 3)
    except (TypeError, ValueError):
        return np.zeros(3)
    return np.where(np.isfinite(numbers), numbers, 0.0)


def rotation_noise(time: Floats, quats: Floats) -> float:
    """Standard deviation of the noise about each axis, rad, of orientations [T, 4].

    A rotation by a small angle a changes a unit quaternion by a/2 in the three directions that keep
    its norm; the noise in the fourth is zero.
    """
    return float(2.0 * np.sqrt((noise_std(time, quats) ** 2).sum() / 3.0))


def smooth_rotation(time: Floats, quats: Floats) -> SmoothedRotation:
    """Smooths and differentiates orientations [T, 4]; NaN marks a missing sample.

    The components are smoothed as four signals and brought back to the sphere; from their
    derivatives w = 2 vec(q* q') and w' = 2 vec(q* q''), as q*' q' is a scalar.
    """
    usual = _UsualSpin.of(time, quats)
    without = usual.taken_from(quats)
    noise = rotation_noise(time, without)
    return _rotation(smooth(time, without, noise_std=noise / 2.0), noise, usual)


@dataclasses.dataclass(frozen=True, eq=False)
class _UsualSpin:
    """A constant spin, without which orientations are smoothed.

    Components of a body that spins at w swing at w / 2: a ball's change so much from sample to
    sample that at the ends of a recording, where a sample has neighbours on one side only, the
    smoothed spin was off by a fifth, and fits of windows that start there did not find back.

    With p = q e*, where e is the turn by the constant spin u in the body's frame, and W the spin of
    p in its own frame: w = u + e* W e, and w' = e* W' e + (e* W e) x u.

    Attributes:
      rate: [3] median spin from sample to sample, in the body's frame, rad/s. turn: [T, 4] by it.
    """

    rate: Floats
    turn: Floats

    @classmethod
    def of(cls, time: Floats, quats: Floats) -> _UsualSpin:
        """The median; none where components swing hardly less without that: noise is all that they
        have, or the body tumbles."""
        step = quat.multiply(quat.conjugate(quats[:-1]), quats[1:])
        rates = quat.log(step) / np.diff(time)[:, None]
        known = np.isfinite(rates).all(axis=1)
        rate = np.median(rates[known], axis=0) if known.any() else np.zeros(3)
        found, none = (cls(u, quat.exp(u * (time - time[0])[:, None])) for u in (rate, 0 * rate))
        return found if found._swing(quats) < _LESS * none._swing(quats) else none

    def _swing(self, quats: Floats) -> float:
        """Sum of the squared third differences of what is left, as large as smoothing is wrong."""
        return float(np.nansum(np.diff(self.taken_from(quats), 3, axis=0) ** 2))

    def taken_from(self, quats: Floats) -> Floats:
        """[T, 4]: orientations without it."""
        return quat.continuous(quat.multiply(quats, quat.conjugate(self.turn)))


_LESS = 0.5
"""Share of the swing of components that is plainly less of it."""


def _rotation(found: Smoothed, noise: float, usual: _UsualSpin) -> SmoothedRotation:
    """The orientation behind four smoothed components, from which a spin was taken."""
    size = np.linalg.norm(found.value, axis=1, keepdims=True)
    inverse, back = quat.conjugate(found.value / size), quat.conjugate(usual.turn)
    rate = 2.0 * quat.multiply(inverse, found.rate / size)[:, 1:]
    second = 2.0 * quat.multiply(inverse, found.second / size)[:, 1:]
    beside = quat.rotate(back, rate)
    return SmoothedRotation(
        quat=quat.multiply(found.value / size, usual.turn),
        angvel=usual.rate + beside,
        angacc=quat.rotate(back, second) + np.cross(beside, usual.rate),
        angle_std=_turned(found.value_std),
        angvel_std=_turned(found.rate_std),
        angacc_std=_turned(found.second_std),
        noise_std=noise,
        jumps=np.asarray(found.jumps.any(axis=1)),
    )


def _turned(component_std: Floats) -> Floats:
    """Standard deviation about one axis from those of four components of which three vary."""
    return np.asarray(2.0 * np.sqrt((component_std**2).mean(axis=1)))


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """Smoothed motion in the scene's order; NaN where nothing was estimated.

    Attributes:
      time: [T], s.
      qpos: [T, nq]. qvel, qacc: [T, nv]; free joints as in MuJoCo, linear parts in the world frame
        and angular parts in the body's frame.
      qpos_std, qvel_std, qacc_std: [T, nv] standard deviations, rotations as angles.
      noise_std: [nv] standard deviation of the measurement noise of positions.
      jumps: [T - 1, nv] whether the velocity jumped between a sample and the next.
    """

    time: Floats
    qpos: Floats
    qvel: Floats
    qacc: Floats
    qpos_std: Floats
    qvel_std: Floats
    qacc_std: Floats
    noise_std: Floats
    jumps: Bools


def estimate_motion(bound: Bound, only: Collection[int] | None = None) -> Motion:
    """Estimates the motion from the recorded positions alone.

    Args:
      bound: the recording in a scene's order.
      only: numbers of the joints to estimate; all if None.
    """
    model, count = bound.model, len(bound.time)
    nv = model.nv
    motion = Motion(
        time=bound.time,
        qpos=np.full((count, model.nq), np.nan),
        noise_std=np.full(nv, np.nan),
        jumps=np.zeros((count - 1, nv), bool),
        **{
            name: np.full((count, nv), np.nan)
            for name in ("qvel", "qacc", "qpos_std", "qvel_std", "qacc_std")
        },
    )
    wanted = [j for j in joints(model) if only is None or j.id in only]
    plan = _Plan(bound, wanted)
    if plan.columns:
        found = smoothed(bound.time, plan.values(), plan.noise())
        _fill_straight(motion, plan, found)
        for joint, place, noise, usual in plan.turning:
            turned = _rotation(_part(found, place), float(noise.min()), usual)
            _fill_turning(motion, joint, turned)
            motion.noise_std[joint.angular] = noise
    for joint in plan.unseen:
        assert joint.quat is not None
        motion.qpos[:, joint.quat] = bound.qpos[:, joint.quat]
        motion.qvel[:, joint.angular] = motion.qacc[:, joint.angular] = 0.0
    return motion


class _Plan:
    """Which columns of qpos are smoothed: all in one call.

    Attributes:
      columns: of qpos. straight_v: columns of qvel that belong to the first of them.
      turning: joints with quaternions, where these stand among them, their noise about each axis,
        [3] rad, and the spin without which they are smoothed.
      unseen: free joints whose orientation does not matter.
    """

    def __init__(self, bound: Bound, wanted: list[Joint]) -> None:
        self.bound = bound
        self.columns: list[int] = []
        self.straight_v: list[int] = []
        stated: list[float] = []
        for joint in wanted:
            width = 3 if joint.kind == Kind.FREE else 1 if joint.scalar else 0
            self.columns += range(joint.q.start, joint.q.start + width)
            self.straight_v += range(joint.v.start, joint.v.start + width)
            stated += stated_noise(bound, joint)[0][:width].tolist()
        self.stated = np.array(stated)
        self.turning: list[tuple[Joint, slice, Floats, _UsualSpin]] = []
        self.unseen = [j for j in wanted if j.id in bound.unseen_turns]
        for joint in wanted:
            if joint.quat is not None and joint not in self.unseen:
                about = stated_noise(bound, joint)[1]
                quats = bound.qpos[:, joint.quat]
                usual = _UsualSpin.of(bound.time, quats)
                noise = np.fmax(rotation_noise(bound.time, usual.taken_from(quats)), about)
                place = slice(len(self.columns), len(self.columns) + 4)
                self.turning.append((joint, place, noise, usual))
                self.columns += range(joint.quat.start, joint.quat.stop)

    def values(self) -> Floats:
        """[T, C]: what is smoothed."""
        found = self.bound.qpos[:, self.columns]
        for joint, place, _, usual in self.turning:
            found[:, place] = usual.taken_from(self.bound.qpos[:, joint.quat])
        return found

    def noise(self) -> Floats:
        """[C]: of every column."""
        straight = self.columns[: len(self.straight_v)]
        each = noise_std(self.bound.time, self.bound.qpos[:, straight])
        each = np.fmax(each, self.stated)
        # components mix the axes: what is known best about one of them is not smoothed away
        return np.concatenate([each, *([n.min() / 2.0] * 4 for _, _, n, _ in self.turning)])


def _part(found: Smoothed, place: slice) -> Smoothed:
    """Some channels of a smoothed signal."""
    values = {field.name: getattr(found, field.name) for field in dataclasses.fields(found)}
    return Smoothed(**{n: v if n == "time" else v[..., place] for n, v in values.items()})


def _fill_straight(motion: Motion, plan: _Plan, found: Smoothed) -> None:
    """Hinges, slides and the translations of free joints."""
    v = plan.straight_v
    q = plan.columns[: len(v)]
    part = _part(found, slice(0, len(v)))
    motion.qpos[:, q] = part.value
    motion.qvel[:, v], motion.qacc[:, v] = part.rate, part.second
    motion.qpos_std[:, v], motion.qvel_std[:, v] = part.value_std, part.rate_std
    motion.qacc_std[:, v], motion.noise_std[v] = part.second_std, part.noise_std
    motion.jumps[:, v] = part.jumps


def _fill_turning(motion: Motion, joint: Joint, found: SmoothedRotation) -> None:
    place = joint.angular
    assert joint.quat is not None
    assert place is not None
    motion.qpos[:, joint.quat] = found.quat
    motion.qvel[:, place], motion.qacc[:, place] = found.angvel, found.angacc
    motion.qpos_std[:, place] = found.angle_std[:, None]
    motion.qvel_std[:, place] = found.angvel_std[:, None]
    motion.qacc_std[:, place] = found.angacc_std[:, None]
    motion.noise_std[place] = found.noise_std
    motion.jumps[:, place] = found.jumps[:, None]
