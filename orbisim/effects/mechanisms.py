"""Effects that make a mechanism of joints: latches and detents.

A scene declares them (a lock that a handle releases, a knob that clicks); a diagnosis finds
latches, and calls detents cogging: they are the same force. Both are functions of the positions, so
that a state holds all there is to know of a lock.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.effects.base import (
    LARGE,
    EffectInstance,
    Hook,
    Parameter,
    StepInputs,
    index_of,
    is_scalar_joint,
    joint_unit,
    names_of_kind,
)
from orbisim.effects.joints import JointEffect
from orbisim.effects.screening import Candidate, Floats, MotionRegressors, Values
from orbisim.errors import InputError, UnknownNameError

Bools = npt.NDArray[np.bool_]

SIDES = {"above": 1.0, "below": -1.0}
"""Option `side` of a latch: where the other joint must be to release it."""


class Latch(JointEffect):
    """Dry friction that holds a joint near a position until another joint releases it.

    While |q - position| <= width and the joint of the option `other` is not beyond `threshold` (on
    the option's `side`, `above` or `below`), the joint's friction loss is larger by `force`: a lock
    where that is more than anything can pull, a catch where it is less. Without `other` nothing
    releases it but force.
    """

    name = "latch"
    rarity = -2.0
    phrase = "a latch"
    native = False
    unranked = True
    needs = (mujoco.mjtDisableBit.mjDSBL_CONSTRAINT, mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS)

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        unit, way = joint_unit(model, target, "N*m", "N"), joint_unit(model, target, "rad", "m")
        return (
            Parameter("force", unit, 0.0, LARGE, 1.0),
            Parameter("position", way, -100.0, 100.0, 0.0),
            Parameter("width", way, 0.0, 100.0, 0.01),
            Parameter("threshold", "SI", -100.0, 100.0, 0.1),
        )

    def check_values(self, model: mujoco.MjModel, instance: EffectInstance) -> None:
        super().check_values(model, instance)
        options = instance.options
        if unknown := sorted(set(options) - {"other", "side"}):
            raise UnknownNameError("option of latch", unknown[0], ("other", "side"))
        if "other" in options and not is_scalar_joint(model, options["other"]):
            raise InputError(
                f"latch at {instance.target!r}: {options['other']!r} is not a hinge or a slide"
            )
        if options.get("side", "above") not in SIDES:
            raise UnknownNameError("side of a latch", options["side"], SIDES)

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        return _LatchHook(model, instance)

    def free_parameters(self, model: mujoco.MjModel, target: str) -> tuple[str, ...]:
        """Its place is where the joint was seen to be held."""
        return ("force", "threshold")

    def stepwise(self, instance: EffectInstance, name: str) -> bool:
        """What releases it: a change of the threshold concerns no sample, or some from then on."""
        return name == "threshold" and "other" in instance.options

    def scaled(self, values: Values, size: float) -> Values:
        """As strong so many times; the place stays."""
        return {**values, "force": size * values["force"]}

    def screen(self, view: MotionRegressors, target: str) -> list[Candidate]:
        """Where the joint stood though something moved it, and what released it.

        The column is the force that kept it there; what the latch does while the joint moves is
        left to simulation. Nothing is offered where a joint that is pulled keeps moving.
        """
        joint = _Course.of(view, target)
        held = joint.held
        if held.sum() < _FEWEST:
            return []
        low, high = np.quantile(joint.q[held & joint.near(_densest(joint.q, held))], _MOST)
        position, width = 0.5 * (low + high), 0.5 * (high - low) + 3 * joint.noise
        there = np.abs(joint.q - position) <= width
        if (held & there).sum() < _FEWEST:
            return []
        place = {"position": float(position), "width": float(width)}
        size = float(np.quantile(np.abs(joint.force[held & there]), _STRONGEST))
        catch = {"force": size, **place, "threshold": 0.0}
        found = [self._candidate(view, target, joint.force * (held & there), catch, {})]
        for other in names_of_kind(view.model, "joint"):
            if other == target or not is_scalar_joint(view.model, other):
                continue
            q = _Course.of(view, other).q
            for side, threshold in _released(q, held & there, joint.moves & there):
                lock = {"force": _SURE * size, **place, "threshold": threshold}
                options = {"other": other, "side": side}
                locked = held & there & ~(SIDES[side] * (q - threshold) > 0)
                force = joint.force * locked
                found.append(self._candidate(view, target, force, lock, options))
        return found

    def _candidate(
        self,
        view: MotionRegressors,
        target: str,
        force: Floats,
        values: Values,
        options: Mapping[str, str],
    ) -> Candidate:
        return self.candidate(
            view,
            target,
            [np.concatenate([force, force])],
            functools.partial(_as_found, values),
            options=options,
            fixed=True,
            shape=1,
        )


class Detent(JointEffect):
    """A force -A sin(2 pi (q - position) / pitch) that draws a joint to places a pitch apart.

    A diagnosis calls such a force `cogging`: it is the same.
    """

    name = "detent"
    phrase = "detents"
    native = False

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        unit, way = joint_unit(model, target, "N*m", "N"), joint_unit(model, target, "rad", "m")
        return (
            Parameter("amplitude", unit, 0.0, LARGE, 0.1),
            Parameter("pitch", way, 1e-6, 100.0, 0.5),
            Parameter("position", way, -100.0, 100.0, 0.0),
        )

    def hook(self, model: mujoco.MjModel, instance: EffectInstance) -> Hook:
        return _DetentHook(model, instance)


def _as_found(values: Values, c: Floats) -> Values:
    return values


class _Course:
    """A joint along the measured motion, at the starts of the sampling intervals.

    Attributes:
      q: [N]. force: [N] that is missing. noise: of positions, at most.
      held: [N] whether it stands though much force is missing. moves: [N].
    """

    def __init__(
        self, q: Floats, v: Floats, force: Floats, noise: float, step: float, limits: Floats
    ) -> None:
        self.q, self.noise, self._travel = q, noise, float(np.ptp(q))
        self.force = _running_median(force)
        rough = _running_median(np.abs(force - self.force))
        slow = max(2 * noise / step, _SLOW * float(np.sqrt(np.mean(v**2))))
        still = np.abs(v) < slow
        size = np.abs(self.force)
        shown = still & (size > _SHOWN * rough)
        most = float(np.quantile(size[shown], _STRONGEST)) if shown.any() else 0.0
        edge = _EDGE * self._travel  # at a stop, only what moves away from it must be held
        back = (q < limits[0] + edge) & (self.force > 0)
        back |= (q > limits[1] - edge) & (self.force < 0)
        self.held = shown & (size > _FAINT * most) & ~back
        self.moves = np.abs(v) > 2 * slow

    def near(self, place: float) -> Bools:
        """[N]: where the joint is near a place."""
        return np.asarray(np.abs(self.q - place) <= _LOCAL * self._travel)

    @staticmethod
    def of(view: MotionRegressors, target: str) -> _Course:
        joint = index_of(view.model, "joint", target)
        dof, n = int(view.model.jnt_dofadr[joint]), len(view.time) // 2
        missing = view.missing_force
        force = np.zeros(n) if missing is None else np.nan_to_num(missing[:, dof])
        step = float(np.median(view.time[n:] - view.time[:n]))
        noise = float(view.velocity_noise[dof]) * step
        q = np.asarray(view.qpos[:n, int(view.model.jnt_qposadr[joint])])
        limited = bool(view.model.jnt_limited[joint])
        limits = view.model.jnt_range[joint] if limited else np.array([-np.inf, np.inf])
        return _Course(q, np.asarray(view.qvel[:n, dof]), force, noise, step, limits)


def _running_median(values: Floats) -> Floats:
    padded = np.pad(values, _AROUND, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _AROUND + 1)
    return np.asarray(np.median(windows, axis=1))


def _densest(q: Floats, held: Bools) -> float:
    """Where along its travel a joint is held most often."""
    reach = 0.5 * _LOCAL * np.ptp(q)
    places = np.unique(np.quantile(q[held], np.linspace(0, 1, 41)))
    return float(max(places, key=lambda place: (np.abs(q[held] - place) <= reach).sum()))


_AROUND = 5
"""Samples to either side over which a force must last: at a stop it is mostly noise."""
_SHOWN, _FAINT = 1.5, 0.2
"""Missing force over its scatter, and over its largest, from which on it shows."""
_EDGE = 0.02
"""Share of the travel that a stop gives way."""
_SLOW = 0.05
"""Share of a joint's usual velocity below which it may be standing."""
_STRONGEST = 0.95
"""Quantile of the forces that hold it that stands for the largest: single samples are noise."""
_FEWEST = 20
"""Samples in which a joint must be held, for a latch to be a suspect."""
_MOST = (0.02, 0.98)
"""Quantiles of the positions at which it is held that a latch must cover."""
_LOCAL = 0.1
"""Half the width of a latch, in units of the travel, at most: what holds everywhere is friction."""
_SURE = 3.0
"""A lock's force over what it was seen to hold: nothing says how much more it would."""
_BETTER = 0.6
"""Share of errors, of those without, that another joint may leave to be what releases."""


def _released(q: Floats, held: Bools, moves: Bools) -> Iterator[tuple[str, float]]:
    """Sides and thresholds of another joint that tell where a joint is held from where it moves.

    Each is the best stump, samples of both kinds weighing the same; none if none tells.
    """
    if held.sum() < _FEWEST or moves.sum() < 3:
        return
    for side, sign in SIDES.items():
        grid = np.unique(np.quantile(sign * q[held | moves], np.linspace(0, 1, 64)))
        wrong = np.array(
            [np.mean(sign * q[held] > at) + np.mean(sign * q[moves] <= at) for at in grid]
        )
        best = np.flatnonzero(wrong <= wrong.min() + 1e-9)
        if wrong.min() < _BETTER:
            last = min(int(best[-1]) + 1, len(grid) - 1)
            yield side, float(sign * 0.5 * (grid[best[0]] + grid[last]))


class _LatchHook(Hook):
    def __init__(self, model: mujoco.MjModel, instance: EffectInstance) -> None:
        super().__init__(instance.values)
        joint = index_of(model, "joint", instance.target)
        self._q, self._v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        other = instance.options.get("other")
        self._other = (
            None if other is None else int(model.jnt_qposadr[index_of(model, "joint", other)])
        )
        self._side = SIDES[instance.options.get("side", "above")]

    def fields(self, inputs: StepInputs) -> None:
        away = np.abs(inputs.qpos[:, self._q] - self.value("position"))
        engaged = away <= self.value("width")
        if self._other is not None:
            beyond = inputs.qpos[:, self._other] - self.value("threshold")
            engaged = engaged & ~(self._side * beyond > 0)
        losses = inputs.fields["dof_frictionloss"]
        losses[:, self._v] += np.where(engaged, self.value("force"), 0.0)


class _DetentHook(Hook):
    def __init__(self, model: mujoco.MjModel, instance: EffectInstance) -> None:
        super().__init__(instance.values)
        joint = index_of(model, "joint", instance.target)
        self._q, self._v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])

    def force(self, inputs: StepInputs) -> None:
        away = inputs.qpos[:, self._q] - self.value("position")
        wave = np.sin(2 * np.pi * away / self.value("pitch"))
        inputs.qfrc[:, self._v] -= self.value("amplitude") * wave
