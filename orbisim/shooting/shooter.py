"""Free-running simulation of windows of recordings from given starts."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterator, Sequence

import mujoco
import mujoco.batch
import numpy as np
import numpy.typing as npt

from orbisim.effects.base import Hook
from orbisim.effects.carry import hooks_of
from orbisim.effects.measurement import TRUE, Measurement
from orbisim.effects.running import derived_of, same_physics, side_by_side
from orbisim.effects.stepping import BatchStepper, Timesteps
from orbisim.host.cpus import threads_for
from orbisim.host.deadline import NEVER, Deadline
from orbisim.motion.hidden import Layout, carried_along
from orbisim.motion.linear import Intervals
from orbisim.motion.samples import Samples, parts_of, substeps
from orbisim.recording.initial import stagger
from orbisim.recording.joints import Kind, joints
from orbisim.scene import Scene
from orbisim.shooting.windows import Windows, chosen, start_size, whitening_of

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]


@dataclasses.dataclass(frozen=True, eq=False)
class Variant:
    """A scene to simulate, and how it is measured."""

    scene: Scene
    measurement: Measurement = TRUE


class Shooter:
    """Simulates windows of recordings.

    Args:
      declared: the scene as declared, whose coordinates the samples have.
      samples: the recordings. intervals: their sampling intervals. windows: what to simulate.
      noise: standard deviations of positions and velocities, each [nv].
      deadline: when simulation ends with `TimeIsUpError`.
    """

    def __init__(
        self,
        declared: Scene,
        samples: Sequence[Samples],
        intervals: Intervals,
        windows: Windows,
        noise: tuple[Floats, Floats],
        deadline: Deadline = NEVER,
    ) -> None:
        self.declared, self.samples, self.windows = declared, samples, windows
        self.recording, self.joints = windows.recording, joints(declared.model)
        self.nv, self.deadline = declared.model.nv, deadline
        self.horizon = windows.length
        rows = [
            (samples[i], int(intervals.row[f]))
            for i, f in zip(windows.recording, windows.first, strict=True)
        ]
        k = windows.length
        self.row = np.array([r for _, r in rows], np.int64)
        self.time = np.array([s.time[r : r + k + 1] for s, r in rows])
        self.qpos = np.array([s.qpos[r : r + k + 1] for s, r in rows])
        self.qvel = np.array([s.qvel[r : r + k + 1] for s, r in rows])
        deviation = np.array(
            [np.concatenate([s.dq[r : r + k + 1], s.dv[r : r + k + 1]], axis=1) for s, r in rows]
        )
        sigma = np.concatenate(noise)
        self.measured = np.flatnonzero(np.isfinite(sigma))
        self.weight = 1.0 / sigma[self.measured]
        self.first_seen = np.nan_to_num(deviation[:, 0])
        picked = deviation[:, :, self.measured]
        self.seen = np.isfinite(picked) & chosen(windows.predictable(), self.measured)
        self.target = np.where(self.seen, picked, 0.0) * self.weight
        self.whitening = whitening_of(windows, self.measured, self.seen)
        self.absolute = np.array([s.absolute[r : r + k + 1] for s, r in rows])
        step = float(declared.model.opt.timestep)
        lengths = np.diff(self.time, axis=1)
        self.start_size = start_size(noise, float(np.median(lengths)))
        self.substeps = int(substeps(np.median(lengths), step))
        self._read_inputs()

    def _read_inputs(self) -> None:
        """Controls [W, K, parts, nu] and forces [W, K, parts, nv], constant over an interval, or
        over each of its timesteps."""
        self.parts = parts_of(self.samples, self.substeps)
        self.inputs = [one.inputs(self.parts) for one in self.samples]
        rows, k = list(zip(self.recording, self.row, strict=True)), self.windows.length
        self.ctrl, self.force = (
            np.array([self.inputs[i][n][r : r + k] for i, r in rows]) for n in (0, 1)
        )

    def __len__(self) -> int:
        return len(self.windows)

    def first(self, samples: int) -> Shooter:
        """The same windows, of which only so many samples are looked at."""
        part = copy.copy(self)
        part.horizon = min(samples, self.windows.length)
        part.seen = self.seen & (np.arange(self.windows.length + 1) <= part.horizon)[:, None]
        part.target = np.where(part.seen, self.target, 0.0)
        part.whitening = whitening_of(self.windows, self.measured, part.seen)
        return part

    def some(self, which: Ints) -> Shooter:
        """Only the windows of these numbers, in this order; one may come several times."""
        part = copy.copy(self)
        for name in _OF_WINDOWS:
            setattr(part, name, getattr(self, name)[which])
        part.windows = self.windows.some(which)
        part.whitening = None if self.whitening is None else self.whitening.some(which)
        return part

    def plain(self) -> Shooter:
        """The same where what impacts leave unknown counts as if it was known."""
        part = copy.copy(self)
        part.windows = dataclasses.replace(self.windows, scatter=None)
        part.whitening = None
        return part

    @property
    def count(self) -> int:
        """Number of data."""
        return int(self.seen.sum())

    @property
    def data(self) -> Ints:
        """[W]: number of data of each window."""
        return np.asarray(self.seen.reshape(len(self), -1).sum(axis=1))

    def simulate(self, variant: Variant, start: Floats, only: Bools | None = None) -> Floats:
        """Measured deviations from the reference [W, K + 1, 2 nv] of free runs from the starts.

        Args:
          variant: the scene to simulate and how it is measured.
          start: [W, 2 nv + 2 h] true deviation at each window's start, and position and velocity
            of the h joints that effects have added.
          only: [W] the windows to simulate, all if None; what is returned of others is meaningless,
            as is what lies beyond a window's horizon.
        """
        if only is not None and not only.all():
            out, which = np.zeros(self.shape), np.flatnonzero(only)
            if len(which):
                out[which] = self.some(which).simulate(variant, start[which])
            return out
        return self._simulated(variant, start)

    def staggered(self, variant: Variant) -> float:
        """By how much before their positions velocities of simulated states belong, s."""
        interval = float(np.median(np.diff(self.time, axis=1)))
        step = interval / (self.substeps * variant.measurement.clock)
        return stagger(variant.scene.model) * step

    def _read(self, variant: Variant, out: Floats) -> Floats:
        """What is measured of true deviations [W, K + 1, 2 nv].

        A late sensor reads, at a window's beginning, what was before, which nothing says: there the
        readings are taken as those that were measured, and what is off in the others of the same
        window and sensor counts more, by as much as there are fewer. What is off in the mean square
        is then no less for a longer delay. Where nearly all of a window is read from beyond it, the
        readings stay extrapolated (`Measurement`).
        """
        measurement = variant.measurement
        if not measurement:
            return out
        runs = measurement.of(self.absolute, out, self.time, self.staggered(variant))
        for k, column, delay in self._late(measurement):
            counts, target = self._counts(k, delay), self.target[..., k] / self.weight[k]
            inferred = np.where(counts > 0, target + counts * (runs[..., column] - target), target)
            runs[..., column] = np.where(counts == 1, runs[..., column], inferred)
        return runs

    def _late(self, measurement: Measurement) -> Iterator[tuple[int, int, float]]:
        """Numbers of measured signals that are late, their columns, and by how much, s."""
        if measurement.delay is not None:
            for k, column in enumerate(self.measured):
                if measurement.delay[column]:
                    yield k, int(column), float(measurement.delay[column])

    def _counts(self, k: int, delay: float) -> Floats:
        """[W, K + 1] by how much what is off in a late signal counts: zero where it reads from
        beyond the window, elsewhere more than one; one of all where nearly all is from beyond."""
        ends = np.arange(len(self)), np.minimum(self.windows.reach(), self.horizon)
        near = np.median(np.diff(self.time, axis=1)) / 2.0  # `Measurement` is good so far beyond
        at, seen = self.time - delay, self.seen[..., k]
        known = (at > self.time[:, :1] - near) & (at < self.time[ends][:, None] + near)
        every, left = seen.sum(axis=1), (seen & known).sum(axis=1)
        more = np.sqrt(every / np.maximum(left, 1))[:, None]
        return np.where((_KNOWN * left > every)[:, None], np.where(known, more, 0.0), 1.0)

    def read_late(self, free: Floats, measurement: Measurement) -> Floats:
        """Derivatives of the weighted data by the window starts as late sensors read them: linear
        between samples.

        Args:
          free: [W, data, 2 nv] of the motion; returned as they are where no sensor is late.
        """
        if not measurement.shifted:
            return free
        out = free.reshape(len(self), self.windows.length + 1, len(self.measured), -1).copy()
        windows = np.arange(len(self))[:, None]
        for k, _, delay in self._late(measurement):
            at = self.time - delay
            rows = zip(self.time, at, strict=True)
            before = np.stack([np.searchsorted(t, wanted, side="right") - 1 for t, wanted in rows])
            before = np.clip(before, 0, self.windows.length - 1)
            start, stop = self.time[windows, before], self.time[windows, before + 1]
            share = np.clip((at - start) / (stop - start), 0.0, 1.0)[..., None]
            there = out[:, :, k]
            read = (1 - share) * there[windows, before] + share * there[windows, before + 1]
            out[:, :, k] = read * (self._counts(k, delay) * self.seen[..., k])[..., None]
        return out.reshape(free.shape)

    def _simulated(
        self, variant: Variant, start: Floats, hooks: list[Hook] | None = None
    ) -> Floats:
        out = np.zeros(self.shape)
        out[:, 0] = start[:, : 2 * self.nv]
        for span, qpos, qvel in self._run(variant, start, hooks):
            out[:, span] = self._deviation(span, qpos, qvel)
        return self._read(variant, out)

    def simulate_each(self, variants: Sequence[Variant], start: Floats) -> list[Floats]:
        """As `simulate`, of several scenes from the same starts. Those that differ only in how they
        are measured are simulated once, those that differ in the numbers of hooks at once: hooks
        are called in every timestep, and take as long for all scenes as for one."""
        found: list[Floats | None] = [None] * len(variants)
        hooks = [hooks_of(one.scene.model) for one in variants]
        for same in self._alike(variants, hooks):
            first, count = variants[same[0]], len(same)
            joined = side_by_side([hooks[i] for i in same], len(self)) if count > 1 else None
            if joined is None:
                for i in same:
                    found[i] = self.simulate(variants[i], start)
                continue
            runs = count if joined else 1
            part = self.some(np.tile(np.arange(len(self)), runs))
            true = dataclasses.replace(first, measurement=Measurement(first.measurement.clock))
            out = part._simulated(true, np.tile(start, (runs, 1)), joined)
            for k, i in enumerate(same):
                seen = out.reshape(runs, *self.shape)[k % runs]
                found[i] = self._read(variants[i], seen)
        return [one for one in found if one is not None]

    def _alike(
        self, variants: Sequence[Variant], hooks: Sequence[Sequence[Hook]]
    ) -> list[list[int]]:
        """Numbers of scenes that simulate alike but for the numbers of their hooks, grouped; where
        neither hooks nor measurements can tell scenes apart, they are not even compared."""
        groups: list[list[int]] = []
        for i, one in enumerate(variants):
            for same in groups if hooks[i] or one.measurement else ():
                first = variants[same[0]]
                kinds = [[type(hook) for hook in hooks[k]] for k in (i, same[0])]
                timed = one.measurement.clock == first.measurement.clock
                if (
                    kinds[0] == kinds[1]
                    and timed
                    and same_physics(one.scene.model, first.scene.model)
                ):
                    same.append(i)
                    break
            else:
                groups.append([i])
        return groups

    def moved(self, variant: Variant, start: Floats, steps: Floats, which: Ints) -> Floats:
        """As `simulate` of some windows, with each number of their starts moved by its step in
        turn: [2 nv + 2 h, windows, K + 1, 2 nv].

        Args:
          steps: [2 nv + 2 h].
        """
        columns, out = start.shape[1], np.zeros((start.shape[1], len(which), *self.shape[1:]))
        size = max(1, _AT_ONCE // max(len(which), 1))
        for begin in range(0, columns if len(which) else 0, size):
            some = range(begin, min(begin + size, columns))
            part = self.some(np.tile(which, len(some)))
            moves = np.repeat(np.diag(steps)[some], len(which), axis=0)
            runs = part.simulate(variant, np.tile(start[which], (len(some), 1)) + moves)
            out[begin : some.stop] = runs.reshape(len(some), len(which), *self.shape[1:])
        return out

    def states(self, variant: Variant, start: Floats) -> tuple[Floats, Floats]:
        """True states of free runs: qpos [W, K + 1, nq] and qvel [W, K + 1, nv]."""
        first = self._moved(start)
        qpos, qvel = self.qpos.copy(), self.qvel.copy()
        qpos[:, 0], qvel[:, 0] = first
        for span, here_q, here_v in self._run(variant, start):
            qpos[:, span], qvel[:, span] = here_q, here_v
        return qpos, qvel

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of the simulated data: windows, samples, positions and velocities."""
        return len(self), self.windows.length + 1, 2 * self.nv

    def _run(
        self, variant: Variant, start: Floats, hooks: list[Hook] | None = None
    ) -> Iterator[tuple[slice, Floats, Floats]]:
        """Which samples, and positions [W, n, nq] and velocities [W, n, nv] there, some samples
        after the others.

        Args:
          hooks: instead of the scene's.
        """
        model, clock = variant.scene.model, variant.measurement.clock
        place = Layout(self.declared.model, model)
        hooks = hooks or hooks_of(model)
        last = np.minimum(self.windows.reach(), self.horizon)
        spans = list(self._spans(last, one_by_one=bool(hooks)))
        most = 1 if hooks else self.substeps * max((count for _, count in spans), default=1)
        threads = threads_for(model, len(self), most)
        kept = bool(derived_of(hooks)) and self.horizon * self.substeps > _WORTH_KEEPING
        batch = mujoco.batch.Batch(model, len(self), threads, persistent=kept)
        qpos, qvel = self._moved(start)
        batch.bind("qpos")[:] = model.qpos0
        batch.bind("qpos")[:, place.q] = qpos
        batch.bind("qvel")[:] = 0.0
        batch.bind("qvel")[:, place.v] = qvel
        hidden = (start.shape[1] - 2 * self.nv) // 2
        if hidden:
            unseen = start[:, 2 * self.nv :]
            batch.bind("qpos")[:, place.hidden_q] += unseen[:, :hidden]
            batch.bind("qvel")[:, place.hidden_v] = unseen[:, hidden:]
        batch.bind("time")[:] = self.time[:, 0]
        if model.na or model.nhistory:
            act, history = self._hidden(model)
            batch.bind("act")[:], batch.bind("history")[:] = act, history
        timesteps, stepper = Timesteps(model, batch), BatchStepper(model, batch, hooks)
        applied, qpos, qvel = (batch.bind(n) for n in ("qfrc_applied", "qpos", "qvel"))
        for k, count in spans:
            self.deadline.check()
            length = (self.time[:, k + count] - self.time[:, k]) / (count * clock)
            timesteps.set(length / self.substeps)
            ids, some = np.flatnonzero(last > k), slice(k, k + count)
            every = None if len(ids) == len(self) else ids
            shape = len(self), count
            found_q, found_v = np.zeros((*shape, len(place.q))), np.zeros((*shape, len(place.v)))
            if hooks:
                for part in range(self.parts):
                    applied[:, place.v] = self.force[:, k, part]
                    steps = self.substeps // self.parts
                    stepper.step(self.ctrl[:, k, part], steps, every, more=True)
                found_q[:, 0], found_v[:, 0] = qpos[:, place.q], qvel[:, place.v]
            else:
                force = np.zeros((len(ids), count, self.parts, model.nv))
                force[..., place.v] = self.force[ids, some]
                control = np.concatenate([self.ctrl[ids, some], force], axis=3)
                control = control.reshape(len(ids), count * self.parts, -1)
                control = np.repeat(control, self.substeps // self.parts, axis=1)
                record = batch.rollout(control.shape[1], control, _INPUTS, ("qpos", "qvel"), every)
                ends = slice(self.substeps - 1, None, self.substeps)
                found_q[ids] = record["qpos"][:, ends, place.q]
                found_v[ids] = record["qvel"][:, ends, place.v]
            yield slice(k + 1, k + 1 + count), found_q, found_v

    def _spans(self, last: Ints, one_by_one: bool) -> Iterator[tuple[int, int]]:
        """First interval and number of intervals that can be simulated in one call: no window ends
        within, and the intervals of each window are alike.

        Args:
          last: [W] intervals to simulate of each window.
        """
        stop, k = int(last.max(initial=0)), 0
        if one_by_one:
            yield from ((number, 1) for number in range(stop))
            return
        most = max(1, _IN_ONE_CALL // max(len(self) * self.substeps, 1))
        length = np.diff(self.time, axis=1)
        going_on = np.arange(1, length.shape[1]) < last[:, None]
        # times that are off an even grid by a share have second differences of four times that
        uneven = (np.abs(np.diff(length, axis=1)) > 4 * _EVEN * length[:, 1:]) & going_on
        ends = np.union1d(np.flatnonzero(uneven.any(axis=0)) + 1, last)
        while k < stop:
            count = min(most, int(ends[np.searchsorted(ends, k, side="right")]) - k)
            time = self.time[last > k]
            while count > 1 and not _even(time[:, k : k + count + 1]):
                count //= 2
            yield k, count
            k += count

    def chained(self, intervals: Intervals) -> Floats:
        """Derivatives of the weighted data by the window starts in linear approximation,
        [W, data, 2 nv]."""
        n2 = 2 * self.nv
        x = np.tile(np.eye(n2), (len(self), 1, 1))
        out = np.empty((len(self), self.windows.length + 1, n2, n2))
        for k in range(self.windows.length + 1):
            out[:, k] = x
            if k < self.windows.length:
                x = np.einsum("wij,wjc->wic", intervals.A[self.windows.first + k], x)
        return self.scaled(out)

    def respond(self, intervals: Intervals, inputs: Floats) -> Floats:
        """Linear response of the weighted data to inputs [N, 2 nv, C], [W, data, C]."""
        n2, width = 2 * self.nv, inputs.shape[2]
        x = np.zeros((len(self), n2, width))
        out = np.zeros((len(self), self.windows.length + 1, n2, width))
        for k in range(self.windows.length):
            at = self.windows.first + k
            x = np.einsum("wij,wjc->wic", intervals.A[at], x) + inputs[at]
            out[:, k + 1] = x
        return self.scaled(out)

    def scaled(self, values: Floats) -> Floats:
        """Deviations [W, K + 1, 2 nv, ...] as weighted data [W, data, ...]; zero where unseen."""
        extra = (1,) * (values.ndim - 3)
        picked = values[:, :, self.measured] * self.weight.reshape(-1, *extra)
        picked = np.where(self.seen.reshape(*self.seen.shape, *extra), picked, 0.0)
        picked = np.clip(np.nan_to_num(picked), -1e12, 1e12)
        if self.whitening is not None:
            picked = self.whitening(picked)
        return np.asarray(picked.reshape(len(self), -1, *values.shape[3:]))

    def residual(self, simulated: Floats) -> Floats:
        """Weighted measured minus simulated deviations [W, data]; zero where not measured."""
        values = simulated[:, :, self.measured] * self.weight
        values = np.where(self.seen, self.target - values, 0.0)
        lost = ~np.isfinite(values)
        values[lost] = _LOST
        values = np.clip(values, -_LOST, _LOST)
        if self.whitening is not None:
            values = self.whitening(values)
        return values.reshape(len(self), -1)

    def _moved(self, start: Floats) -> tuple[Floats, Floats]:
        qpos, qvel = self.qpos[:, 0].copy(), self.qvel[:, 0] + start[:, self.nv : 2 * self.nv]
        if qpos.shape[1] == self.nv:
            return qpos + start[:, : self.nv], qvel
        for w in range(len(qpos)):
            delta = np.ascontiguousarray(start[w, : self.nv])
            mujoco.mj_integratePos(self.declared.model, qpos[w], delta, 1.0)
        return qpos, qvel

    def _deviation(self, span: slice, qpos: Floats, qvel: Floats) -> Floats:
        before, count = self.qpos[:, span], qpos.shape[2]
        dq = self.difference(before.reshape(-1, count), qpos.reshape(-1, count))
        return np.concatenate([dq.reshape(qvel.shape), qvel - self.qvel[:, span]], axis=2)

    def difference(self, before: Floats, after: Floats) -> Floats:
        """Tangent vectors [N, nv] from some positions [N, nq] to others."""
        if before.shape[1] == self.nv:
            return after - before
        dq = np.zeros((len(before), self.nv))
        for joint in self.joints:
            turn, angular = joint.quat, joint.angular
            straight = 1 if joint.scalar else 3 if joint.kind == Kind.FREE else 0
            q, v = joint.q.start, joint.v.start
            dq[:, v : v + straight] = (after - before)[:, q : q + straight]
            if turn is not None and angular is not None:
                dq[:, angular] = _turned(before[:, turn], after[:, turn])
        return dq

    def _hidden(self, model: mujoco.MjModel) -> tuple[Floats, Floats]:
        """Activations and delay buffers at the windows' starts."""
        act = np.zeros((len(self), model.na))
        history = np.zeros((len(self), model.nhistory))
        for number in np.unique(self.windows.recording):
            here = np.flatnonzero(self.windows.recording == number)
            rows, again = np.unique(self.row[here], return_inverse=True)
            found = carried_along(self.samples[number], self.declared.model, model, rows)
            act[here], history[here] = (values[again] for values in found)
        return act, history


_OF_WINDOWS = (
    "row", "time", "qpos", "qvel", "ctrl", "force", "first_seen", "seen", "target", "absolute",
    "recording",
)  # fmt: skip
"""What a shooter knows of each window."""
_AT_ONCE = 512
"""Windows that are simulated at once at most where starts are moved."""
_INPUTS = mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_QFRC_APPLIED.value
_IN_ONE_CALL = 50_000
"""Timesteps of all worlds between two looks at the clock: a second of worlds with contacts."""
_WORTH_KEEPING = 64
"""Timesteps of a window from which on each world keeps its data: to make these takes as long as
some 60 steps save by going on from what the last one computed."""
_EVEN = 1e-4
"""Share of an interval by which times are off an even grid that is none: rounding of stamps. What a
joint moves in it is a ten-thousandth of what it moves between two samples."""
_KNOWN = 4
"""What a late sensor reads of a window, over what of it is known, at most: fewer readings cannot
stand for all."""
_LOST = 1e6
"""Weighted residual of what has diverged: finite, so that windows can still be compared."""


def _turned(before: Floats, after: Floats) -> Floats:
    """Rotation vectors [N, 3] from some unit quaternions [N, 4] to others, in the frames of the
    former, as `mujoco.mj_differentiatePos` has them: that is called for one state at a time."""
    w, one = before[:, :1], before[:, 1:]
    scalar = (before * after).sum(axis=1)
    axis = w * after[:, 1:] - after[:, :1] * one - np.cross(one, after[:, 1:])
    size = np.linalg.norm(axis, axis=1)
    angle = 2 * np.arctan2(size, scalar)
    angle = np.where(angle > np.pi, angle - 2 * np.pi, angle)
    return np.asarray(axis * (angle / np.maximum(size, 1e-300))[:, None])


def _even(time: Floats) -> bool:
    """Whether times [W, n] are evenly spaced in each row."""
    grid = np.linspace(time[:, 0], time[:, -1], time.shape[1], axis=1)
    return bool((np.abs(time - grid) <= _EVEN * (grid[:, 1:2] - grid[:, :1])).all())
