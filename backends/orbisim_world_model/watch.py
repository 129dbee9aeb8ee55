"""`Watch`: what a learned step says of its own results, as errors, warnings and memory."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbisim.errors import DivergedError
from orbisim.state import Array, State
from orbisim_world_model.stepping import MEMORY, Stepping, Steps

OUTSIDE = "world_model_outside"
"""Memory [nworld, K]: the time, s, at which each entity left the training data; inf for never."""
UNCERTAINTY = "world_model_uncertainty"
"""Memory of a rollout's last state [nworld, T, K, 2]: half-widths of the 90 % intervals of
position, m, and rotation, rad, after each step; of a robot, its hand's."""
FAR, TURNED = 0.05, float(np.deg2rad(20.0))
"""m and rad: an object whose 90 % interval is wider can no longer be said to be predicted."""
_ROUNDING = 1e-5
"""Of a variance, relative: what is that near its limit is looked at in full."""
_MOST_LINES = 20
"""Warnings of single entities in one call; the rest are counted."""

Times = npt.NDArray[np.float64]


class OutsideTrainingWarning(UserWarning):
    """A scene or a state lies outside what a checkpoint was trained on."""


class UncertainPredictionWarning(OutsideTrainingWarning):
    """By its own estimate a prediction is too far off to mean anything."""


class Verdict(NamedTuple):
    """What there is to say of a call.

    Attributes:
      diverged_at: [B] first step that is not usable, -1 for none.
      memory: entries of the state that follows.
      error: what to raise for the worlds that diverged; None for none.
    """

    diverged_at: npt.NDArray[np.int64]
    memory: dict[str, Array]
    error: DivergedError | None


class Watch:
    """Looks at every step of a call.

    Args:
      engine: whose steps they are. label: names backend and scene in messages.
    """

    def __init__(self, engine: Stepping, label: str) -> None:
        self.engine, self.label = engine, label
        self.names = engine.guard.names
        if engine.spreads:  # variances below which no interval is wider
            limits = torch.tensor([FAR, TURNED], dtype=torch.float64)
            self._sure = (1.0 - _ROUNDING) * engine.calibration.variances(limits).numpy()

    def began(self, state: State) -> Times:
        """[B, K]: when entities left the training data, up to a state; warns of a new one's."""
        if OUTSIDE in state.memory:
            return _host(state.memory[OUTSIDE])
        x = self.engine.entities(state).detach()
        if MEMORY not in state.memory:
            for concern in self.engine.guard.concerns(x):
                self.warn(f"state: {concern}")
        outside = self.engine.guard.outside(x).cpu().numpy()
        return np.where(outside, _host(state.time)[:, None], np.inf)

    def verdict(self, state: State, path: Steps, duration: float) -> Verdict:
        """Of a call that led from a state along a path of steps, each so many seconds long."""
        since, start = self.began(state), self.engine.entities(state).detach()
        states = path.states.detach()
        notice = self.engine.guard.watch(states, start)
        left = np.isinf(since) & (notice.outside_at >= 0)
        times = _host(state.time)[:, None] + (notice.outside_at + 1) * duration
        self._warn_of(states, np.argwhere(left), notice.outside_at, times)
        since = np.where(left, times, since)
        memory = {OUTSIDE: as_kind(since, state.qpos)}
        width = self.engine.interval(path.variances)
        if width is not None:
            before = self.engine.interval(self.engine.variance(state))
            self._warn_if_unsure(width, before, _host(state.time), duration)
            memory[UNCERTAINTY] = as_kind(width.transpose(0, 1), state.qpos)
        return Verdict(notice.diverged_at, memory, self._error(notice, duration))

    def controls(
        self, state: State, controls: Array, path: Steps, nstep: int, duration: float
    ) -> None:
        """Warns once of the first control of a rollout that is far outside the training data."""
        found = self.engine.strange_control(state, controls, path, nstep)
        if found is not None:
            step, world, text = found
            time = float(_host(state.time)[world]) + step * nstep * duration
            self.warn(f"world {world}, step {step} (t = {time:.6g} s): {text}")

    def calm(self, state: State) -> bool:
        """Whether there is surely nothing to say of one world's state, as NumPy arrays."""
        if not self.engine.guard.calm(state.qpos, state.qvel, state.act):
            return False
        if not self.engine.spreads:
            return True
        return bool((state.memory[MEMORY][0, :, -2:] < self._sure).all())

    def warn(self, text: str) -> None:
        """Warns of a state or a scene."""
        warnings.warn(f"{self.label}, {text}", OutsideTrainingWarning, stacklevel=5)

    def _warn_of(self, states: Any, left: Any, outside_at: Any, times: Times) -> None:
        for world, entity in left[:_MOST_LINES].tolist():
            step = int(outside_at[world, entity])
            what = self.engine.guard.concern(states.at(step), world, entity)
            self.warn(
                f"world {world}, step {step} (t = {times[world, entity]:.6g} s), "
                f"{self.names[entity]!r} left the training data: {what}"
            )
        if len(left) > _MOST_LINES:
            self.warn(f"{len(left) - _MOST_LINES} more entities left the training data")

    def _warn_if_unsure(
        self, width: Tensor, before: Tensor | None, began: Times, duration: float
    ) -> None:
        """Once, where an object's interval gets wider than `FAR` or `TURNED` [T, B, K, 2]."""
        limit = torch.tensor((FAR, TURNED), device=width.device)
        robot = int(self.engine.layout.has_robot)
        wide = (width[:, :, robot:] > limit).any(-1)
        if before is not None:
            wide &= ~(before[None, :, robot:] > limit).any(-1)
        count = wide.any(0).sum()
        if not int(count):
            return
        step = int(wide.flatten(1).any(1).int().argmax())
        world, entity = (int(i[0]) for i in torch.nonzero(wide[step], as_tuple=True))
        far, turned = width[step, world, robot + entity].tolist()
        text = (
            f"world {world}, step {step} (t = {began[world] + (step + 1) * duration:.6g} s), "
            f"{self.names[robot + entity]!r}: its 90 % interval has grown to {far * 1e3:.3g} mm "
            f"and {np.rad2deg(turned):.3g} degrees (limits {FAR * 1e3:g} mm, 20 degrees), as it "
            f"has for {int(count)} objects in all"
        )
        warnings.warn(f"{self.label}, {text}", UncertainPredictionWarning, stacklevel=4)

    def _error(self, notice: Any, duration: float) -> DivergedError | None:
        worlds = np.flatnonzero(notice.diverged_at >= 0)
        if not worlds.size:
            return None
        first = int(worlds[notice.diverged_at[worlds].argmin()])
        name = self.names[int(notice.entity[first])]
        return DivergedError(
            f"{self.label}: {worlds.size} of {len(notice.diverged_at)} worlds diverged, world "
            f"{first} first, at step {int(notice.diverged_at[first])} by {name!r}; the state is "
            "probably outside what the checkpoint was trained on",
            worlds.tolist(),
        )


def _host(array: Array) -> Times:
    return np.asarray(array.detach().cpu().numpy() if isinstance(array, Tensor) else array, float)


def as_kind(values: Any, reference: Array) -> Array:
    """As the same kind of array as the reference, in double precision on the CPU."""
    if isinstance(reference, Tensor):
        return torch.as_tensor(values, device=reference.device).detach()
    if isinstance(values, Tensor):
        values = values.detach().cpu().numpy()
    return np.asarray(values, np.float64)
