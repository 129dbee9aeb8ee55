"""`Engine`: a checkpoint on a device, stepping states of one scene."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbisim.scene import Scene
from orbisim.state import Array, State
from orbisim.trajectory import Trajectory
from orbisim_world_model.arrays import has_gradient, later, like, tensor
from orbisim_world_model.checkpoint import Checkpoint
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.guard import Guard
from orbisim_world_model.reading import read_attributes, read_settings
from orbisim_world_model.reading_parts import read_parts
from orbisim_world_model.spread import factors_of, half_widths
from orbisim_world_model.stepper import Speedups, Stepper

MEMORY = "world_model_memory"
ATTRIBUTES, SETTINGS = "world_model_attributes", "world_model_settings"
_STALE = frozenset({"qacc_warmstart", "history", "plugin_state", "world_model_uncertainty"})
"""Memory that no longer holds after a learned step: of classical backends, and of a rollout."""


class Steps(NamedTuple):
    """States [T, B, ...] on the device, and the memory [B, ...] after the last.

    Attributes:
      variances: [T, B, K, 2] of a model with a spread (see `spread`); None without.
    """

    states: Entities
    memory: Tensor
    variances: Tensor | None = None

    def every(self, count: int) -> Steps:
        """The last of each `count` steps."""
        kept = Entities(*(field[count - 1 :: count] for field in self.states))
        spread = None if self.variances is None else self.variances[count - 1 :: count]
        return Steps(kept, self.memory, spread)


class Engine:
    """Steps states with a checkpoint.

    Args:
      checkpoint: for the scene's layout.
      device: where to compute.
      speedups: see `Stepper`.
    """

    def __init__(self, checkpoint: Checkpoint, device: torch.device, speedups: Speedups) -> None:
        self.checkpoint, self.layout, self.device = checkpoint, checkpoint.layout, device
        self.stepper = Stepper(checkpoint.model, device, speedups)
        self.guard = Guard(checkpoint.manifest, checkpoint.layout)
        self._exact: Any = None
        self.native: Any = None
        self._fresh = self.stepper.initial_memory(1).float().cpu().numpy()

    def describe(self, scene: Scene) -> None:
        """Takes the descriptors of the scene."""
        attributes, settings = (
            torch.as_tensor(read(scene.model, self.layout), dtype=torch.float32).to(self.device)
            for read in (read_attributes, read_settings)
        )
        self._attributes, self._settings = attributes[None], settings[None]
        self._parts: Tensor | None = None
        if self.layout.parts:
            rows = read_parts(scene.model, self.layout, scene.source)
            self._parts = torch.as_tensor(rows, dtype=torch.float32).to(self.device)[None]
        self.guard = Guard(self.checkpoint.manifest, self.layout, scene.model)
        if self.native is not None:
            self.prepare_native()

    def entities(self, state: State) -> Entities:
        """The state as the model sees it."""
        fields = (tensor(a, self.device) for a in (state.qpos, state.qvel, state.act))
        return self.layout.split(*fields)

    def run(self, state: State, controls: Array, nstep: int) -> Steps:
        """The states after every step under controls [B, T, nu], each held for `nstep` steps."""
        given = (state.qpos, state.qvel, state.act, controls, *state.memory.values())
        gradients = torch.is_grad_enabled() and any(map(has_gradient, given))
        step = self._step_exactly if gradients else self.stepper
        with torch.set_grad_enabled(gradients):
            x = self.stepper.model.completed(self.entities(state))
            memory, context = self._memory(state), self.context(state)
            inputs = tensor(controls, self.device)
            found, spreads = [], []
            for t in range(inputs.shape[1]):
                for _ in range(nstep):
                    x, memory = step(x, memory, inputs[:, t], context)
                    found.append(x)
                    if self.spreads:
                        spreads.append(self.stepper.model.variance(memory).detach())
            stacked = Entities(*(torch.stack(field) for field in zip(*found, strict=True)))
        return Steps(stacked, memory, torch.stack(spreads) if spreads else None)

    @property
    def spreads(self) -> bool:
        """Whether the checkpoint predicts how far off it may be."""
        return self.stepper.model.spread is not None

    def variance(self, state: State) -> Tensor | None:
        """The variances [B, K, 2] that a state carries; None without a spread."""
        if not self.spreads:
            return None
        return self.stepper.model.variance(self._memory(state)).detach()

    def interval(self, variance: Tensor | None) -> Tensor | None:
        """Half-widths [..., K, 2], m and rad, of the 90 % intervals of variances."""
        if variance is None:
            return None
        return half_widths(variance, self.factors)

    @property
    def factors(self) -> Tensor:
        """[K, 2] of the checkpoint's calibration (see `spread.factors_of`)."""
        return factors_of(self.checkpoint.manifest["uncertainty"]["factor"], self.layout)

    def prepare_native(self) -> None:
        """Compiles the step of one world (see `native`).

        Raises:
          MissingDependencyError: there is no C compiler.
        """
        from orbisim_world_model.native import NativeStep

        if self.device.type == "cpu":
            context = Context(self._attributes, self._settings, None, self._parts)
            self.native = NativeStep(self.stepper.model, context)

    def suits_native(self, state: State, control: Array) -> bool:
        """Whether the compiled step can take this state: one world, NumPy, the scene's own."""
        return (
            self.native is not None
            and state.nworld == 1
            and isinstance(state.qpos, np.ndarray)
            and isinstance(control, np.ndarray)
            and ATTRIBUTES not in state.memory
            and SETTINGS not in state.memory
        )

    def native_step(self, state: State, control: Array) -> State:
        """The state after a step."""
        arrays = [state.qpos, state.qvel, state.act]
        memory = state.memory.get(MEMORY, self._fresh)
        if memory.shape != self._fresh.shape:
            memory = self._fresh
        *arrays, memory = self.native(*arrays, control, memory)
        qpos, qvel, act, memory = (a.astype(np.float64) for a in (*arrays, memory))
        kept = {name: value for name, value in state.memory.items() if name not in _STALE}
        time = state.time + self.layout.timestep
        return State(time, qpos, qvel, act, {**kept, MEMORY: memory})

    def corrected(self, state: State, predicted: State, control: Array) -> Steps:
        """The classical prediction [B] for the next state, corrected by the model."""
        with torch.no_grad():
            model = self.stepper.model
            x, base = model.completed(self.entities(state)), self.entities(predicted)
            memory, context = self._memory(state), self.context(state)
            step = model(x, memory, tensor(control, self.device), context, base=base)
            return Steps(Entities(*(field[None] for field in step.state)), step.memory)

    def as_steps(self, state: State) -> Steps:
        """A state as the only one of a path."""
        x, memory = self.entities(state), self._memory(state)
        spread = self.stepper.model.variance(memory)[None] if self.spreads else None
        return Steps(Entities(*(field[None] for field in x)), memory, spread)

    def state(self, before: State, path: Steps, seconds: float) -> State:
        """The last state of a path, so many seconds after it began."""
        qpos, qvel, act = (like(a, before.qpos) for a in self.layout.join(path.states.at(-1)))
        kept = {name: value for name, value in before.memory.items() if name not in _STALE}
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
        flat = Entities(*(field.flatten(0, 1) for field in path.states))
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

    def _step_exactly(
        self, x: Entities, memory: Tensor, control: Tensor, context: Context
    ) -> tuple[Entities, Tensor]:
        """With gradients, in float32."""
        if self._exact is None:
            self._exact = self.checkpoint.model.to(self.device).requires_grad_(False)
        step = self._exact(x, memory, control, context)
        return step.state, step.memory

    def _memory(self, state: State) -> Tensor:
        fresh = self.stepper.initial_memory(state.nworld)
        given = state.memory.get(MEMORY)
        if given is None or tuple(given.shape) != tuple(fresh.shape):
            return fresh
        return tensor(given, self.device).to(fresh.dtype)

    def context(self, state: State) -> Context:
        """The descriptors of each world: the state's own, or the scene's."""
        count = state.nworld
        attributes = tensor(state.memory.get(ATTRIBUTES, self._attributes), self.device)
        settings = tensor(state.memory.get(SETTINGS, self._settings), self.device)
        return Context(
            attributes.expand(count, *self._attributes.shape[1:]),
            settings.expand(count, self._settings.shape[1]),
            None,
            None if self._parts is None else self._parts.expand(count, *self._parts.shape[1:]),
        )
