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
from orbisim_world_model.guard import first_marked
from orbisim_world_model.spread import SURE, WIDER
from orbisim_world_model.stepping import MEMORY, Stepping, Steps

OUTSIDE = "world_model_outside"
"""Memory [nworld, K]: the time, s, at which each entity left the training data; inf for never."""
UNCERTAINTY = "world_model_uncertainty"
"""Memory of a rollout's last state [nworld, T, K, 2]: half-widths of the 90 % intervals of
position, m, and rotation, rad, after each step; of a robot, its hand's."""
UNSURE = "world_model_unsure"
"""Memory [nworld, K] of a model with a spread: the time, s, from which each entity can no longer be
said to be predicted; inf for never, and for a robot without a hand, whose intervals are no pose's.
"""
FAR, TURNED = 0.05, float(np.deg2rad(20.0))
"""m and rad: an object or a hand that is off by more is not predicted. The warning comes as soon as
its 99 % interval is wider, not its 90 % one: by that, one in ten would have failed unannounced. And
what has once been lost is not found again by an interval that shrinks."""
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
            limits = torch.tensor([FAR, TURNED], dtype=torch.float64) / WIDER
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

    def unsure(self, state: State) -> Times:
        """[B, K]: when entities could no longer be said to be predicted, up to a state."""
        if UNSURE in state.memory:
            return _host(state.memory[UNSURE])
        width = self.engine.interval(self.engine.variance(state))
        assert width is not None, "of a model with a spread"
        return np.where(self._wide(width).cpu().numpy(), _host(state.time)[:, None], np.inf)

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
            memory[UNSURE] = as_kind(self._unsure_since(state, width, duration), state.qpos)
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
        sure = (state.memory[MEMORY][0, :, -2:] < self._sure).all(-1)
        return bool((sure | np.isfinite(state.memory[UNSURE][0])).all())

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

    def _unsure_since(self, state: State, width: Tensor, duration: float) -> Times:
        """[B, K] as `unsure`, after steps with these half-widths [T, B, K, 2]; warns once of new
        ones."""
        since, began = self.unsure(state), _host(state.time)
        first = np.asarray(first_marked(self._wide(width)).cpu().numpy(), np.int64)
        new = np.isinf(since) & (first >= 0)
        times = began[:, None] + (first + 1) * duration
        if new.any():
            world, entity = np.unravel_index(np.where(new, first, np.inf).argmin(), new.shape)
            step = int(first[world, entity])
            far, turned = (width[step, world, entity] * WIDER).tolist()
            text = (
                f"world {world}, step {step} (t = {times[world, entity]:.6g} s), "
                f"{self.names[entity]!r}: its {100 * SURE:.0f} % interval has grown to "
                f"{far * 1e3:.3g} mm and {np.rad2deg(turned):.3g} degrees (limits "
                f"{FAR * 1e3:g} mm, 20 degrees), as it has for {int(new.sum())} entities in all"
            )
            warnings.warn(f"{self.label}, {text}", UncertainPredictionWarning, stacklevel=5)
        return np.where(new, times, since)

    def _wide(self, width: Tensor) -> Tensor:
        """[..., K]: which entities can no longer be said to be predicted, from half-widths."""
        limit = torch.tensor((FAR, TURNED), device=width.device)
        wide = (width * WIDER > limit).any(-1)
        layout = self.engine.layout
        if layout.has_robot and not layout.hand:
            wide[..., 0] = False
        return wide

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
