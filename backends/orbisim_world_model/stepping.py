"""`Stepping`: what the backend asks of an engine, whatever it steps."""

from __future__ import annotations

import abc
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbisim.errors import InputError
from orbisim.scene import Scene
from orbisim.state import Array, State
from orbisim.trajectory import Trajectory
from orbisim_world_model.arrays import later, like, tensor
from orbisim_world_model.spread import Calibration

MEMORY = "world_model_memory"
STALE = frozenset({"qacc_warmstart", "history", "plugin_state", "world_model_uncertainty"})
"""Memory that no longer holds after a learned step: of classical backends, and of a rollout."""


class Steps(NamedTuple):
    """States [T, B, ...] on the device, and the memory [B, ...] after the last.

    Attributes:
      states: a named tuple of tensors, as the engine's `entities`.
      variances: [T, B, K, 2] of a model with a spread (see `spread`); None without.
    """

    states: Any
    memory: Tensor
    variances: Tensor | None = None

    def every(self, count: int) -> Steps:
        """The last of each `count` steps."""
        kept = type(self.states)(*(field[count - 1 :: count] for field in self.states))
        spread = None if self.variances is None else self.variances[count - 1 :: count]
        return Steps(kept, self.memory, spread)


class Stepping(abc.ABC):
    """Steps states with a checkpoint.

    Args:
      checkpoint: with `path` and `manifest`. layout: of the scene, with `timestep`, and `split` and
        `join` between coordinates and tensors. device: where to compute.

    Attributes:
      guard: bounds of every step, with the entities' `names`.
      native: the compiled step of one world; None without.
    """

    guard: Any

    def __init__(self, checkpoint: Any, layout: Any, device: torch.device) -> None:
        self.checkpoint, self.layout, self.device = checkpoint, layout, device
        self.native: Any = None

    @abc.abstractmethod
    def describe(self, scene: Scene) -> None:
        """Takes the descriptors of the scene."""

    @abc.abstractmethod
    def run(self, state: State, controls: Array, nstep: int) -> Steps:
        """The states after every step under controls [B, T, nu], each held for `nstep` steps."""

    @abc.abstractmethod
    def memory(self, state: State) -> Tensor:
        """The recurrent memory [B, ...] that a state carries, or a fresh one."""

    def entities(self, state: State) -> Any:
        """The state as the model sees it."""
        fields = (tensor(a, self.device) for a in (state.qpos, state.qvel, state.act))
        return self.layout.split(*fields)

    def strange_control(
        self, state: State, controls: Array, path: Steps, nstep: int
    ) -> tuple[int, int, str] | None:
        """Step and world of a control far outside the training data, in words; None for none."""
        return None

    # -- how far off it may be: engines whose checkpoints say so override these ----------------

    @property
    def spreads(self) -> bool:
        """Whether the checkpoint predicts how far off it may be."""
        return False

    def variance(self, state: State) -> Tensor | None:
        """The variances [B, K, 2] that a state carries; None without a spread."""
        return None

    def interval(self, variance: Tensor | None) -> Tensor | None:
        """Half-widths [..., K, 2], m and rad, of the 90 % intervals of variances."""
        return None

    @property
    def calibration(self) -> Calibration:
        """Of the checkpoint's variances."""
        raise InputError(f"{self.checkpoint.path}: predicts no uncertainty")

    # -- one world by compiled C: likewise -----------------------------------------------------

    def prepare_native(self) -> None:  # noqa: B027 (optional)
        """Compiles the step of one world, where it can be written as C; nothing otherwise."""

    def suits_native(self, state: State, control: Array) -> bool:
        """Whether the compiled step can take this state."""
        return False

    def native_step(self, state: State, control: Array) -> State:
        """The state after a step by compiled C."""
        raise InputError(f"{self.checkpoint.path}: its step is not compiled")

    # -- back to states ------------------------------------------------------------------------

    def as_steps(self, state: State) -> Steps:
        """A state as the only one of a path."""
        x, variance = self.entities(state), self.variance(state)
        spread = None if variance is None else variance[None]
        return Steps(type(x)(*(field[None] for field in x)), self.memory(state), spread)

    def state(self, before: State, path: Steps, seconds: float) -> State:
        """The last state of a path, so many seconds after it began."""
        qpos, qvel, act = (like(a, before.qpos) for a in self.layout.join(path.states.at(-1)))
        kept = {name: value for name, value in before.memory.items() if name not in STALE}
        memory = {**kept, MEMORY: like(path.memory, before.qpos)}
        return State(later(before.time, seconds), qpos, qvel, act, memory)

    def trajectory(
        self,
        before: State,
        controls: Array,
        path: Steps,
        diverged_at: npt.NDArray[np.int64],
        duration: float,
    ) -> Trajectory:
        """All states of a path; `duration` is that of each control."""
        count, worlds = path.states.pos.shape[:2]
        flat = type(path.states)(*(field.flatten(0, 1) for field in path.states))
        qpos, qvel, act = (
            like(a.unflatten(0, (count, worlds)).transpose(0, 1), before.qpos)
            for a in self.layout.join(flat)
        )
        return Trajectory(
            initial=before,
            control=controls,
            time=later(before.time, np.arange(1, count + 1) * duration),
            qpos=qpos,
            qvel=qvel,
            act=act,
            sensordata=None,
            diverged_at=diverged_at,
            final=self.state(before, path, count * duration),
        )
