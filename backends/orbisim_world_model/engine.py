"""`Engine`: a checkpoint on a device, stepping states of one scene."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from orbisim.scene import Scene
from orbisim.state import Array, State
from orbisim_world_model.arrays import has_gradient, tensor
from orbisim_world_model.checkpoint import Checkpoint
from orbisim_world_model.differentiable import DifferentiableStep
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.guard import Guard
from orbisim_world_model.layout import Layout
from orbisim_world_model.reading import read_attributes, read_settings
from orbisim_world_model.reading_articulation import limb_rows
from orbisim_world_model.reading_parts import read_parts
from orbisim_world_model.spread import Calibration, calibration_of
from orbisim_world_model.stepper import Speedups, Stepper, plain_step
from orbisim_world_model.stepping import MEMORY, STALE, Stepping, Steps

ATTRIBUTES, SETTINGS = "world_model_attributes", "world_model_settings"
_STRANGE = 15.0
"""Standard deviations of the training data from which on a control is outside of them: 5.4 at most
in ten episodes of `push`."""


class Descriptors(NamedTuple):
    """A scene's descriptors: as they are, and as the stepper takes them for many steps."""

    given: Context
    described: Context


class Engine(Stepping):
    """Steps states with a checkpoint.

    Args:
      checkpoint: for the scene's layout.
      device: where to compute.
      speedups: see `Stepper`.
    """

    def __init__(self, checkpoint: Checkpoint, device: torch.device, speedups: Speedups) -> None:
        super().__init__(checkpoint, checkpoint.layout, device)
        self.stepper = Stepper(checkpoint.model, device, speedups)
        self.guard = Guard(checkpoint.manifest, checkpoint.layout)
        self._exact: Any = None
        self._fresh = self.stepper.initial_memory(1).float().cpu().numpy()

    def describe(self, scene: Scene) -> None:
        """Takes the descriptors of the scene."""
        attributes, settings = (
            torch.as_tensor(read(scene.model, self.layout), dtype=torch.float32).to(self.device)
            for read in (read_attributes, read_settings)
        )
        self._attributes, self._settings = attributes[None], settings[None]
        self._scenes: Descriptors | None = None  # of as many worlds as were asked for last
        self._parts = parts_of(scene, self.layout, self.device)
        self.guard = Guard(self.checkpoint.manifest, self.layout, scene.model)
        if self.native is not None:
            self.prepare_native()

    def run(self, state: State, controls: Array, nstep: int) -> Steps:
        """The states after every step under controls [B, T, nu], each held for `nstep` steps."""
        given = (state.qpos, state.qvel, state.act, controls, *state.memory.values())
        gradients = torch.is_grad_enabled() and any(map(has_gradient, given))
        step = self._step_exactly if gradients else self.stepper
        described = self.context if gradients else self.described
        with torch.set_grad_enabled(gradients):
            x = self.stepper.model.completed(self.entities(state))
            memory, context = self.memory(state), described(state)
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

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def strange_control(
        self, state: State, controls: Array, path: Steps, nstep: int
    ) -> tuple[int, int, str] | None:
        """The first control [B, T, nu] of a path that is far outside the training data.

        By what the model sees of controls, in standard deviations of its data: a joint that a
        servo always held where it was says nothing of a command that is elsewhere.

        Returns:
          Step, world, and in words what is strange; None if nothing is.
        """
        model = self.stepper.model
        see, given = model.features, tensor(controls, self.device)
        if see.limbs is not None or not given.shape[2]:
            return None
        x = self.entities(state).detach()
        found = []
        for t in range(given.shape[1]):
            z = model.see_control(see.control(x, given[:, t])).abs().nan_to_num(0.0, 0.0)
            found.append(torch.stack([z.max(), z.argmax().to(z.dtype)]))
            x = path.states.at((t + 1) * nstep - 1).detach()
        for t, (largest, place) in enumerate(torch.stack(found).tolist()):
            if largest > _STRANGE:
                world, column = divmod(int(place), len(model.see_control.std))
                return t, world, self._of_control(column, largest)
        return None

    def _of_control(self, column: int, times: float) -> str:
        """In words, what of the controls is so many standard deviations from the training data."""
        std, layout = float(self.stepper.model.see_control.std[column]), self.layout
        if column < layout.nu:
            return f"control {column} is {times * std:.3g} from its mean in training"
        joint = layout.joints[int(self.stepper.model.features.served[column - layout.nu])]
        return (
            f"joint {joint!r} is commanded {times * std:.3g} from where it is (in training "
            f"{std:.2g}, as a standard deviation)"
        )

    @property
    def spreads(self) -> bool:
        """Whether the checkpoint predicts how far off it may be."""
        return self.stepper.model.spread is not None

    def variance(self, state: State) -> Tensor | None:
        """The variances [B, K, 2] that a state carries; None without a spread."""
        if not self.spreads:
            return None
        return self.stepper.model.variance(self.memory(state)).detach()

    def interval(self, variance: Tensor | None) -> Tensor | None:
        """Half-widths [..., K, 2], m and rad, of the 90 % intervals of variances."""
        if variance is None:
            return None
        return self.calibration.half_widths(variance)

    @property
    def calibration(self) -> Calibration:
        """Of the checkpoint's variances."""
        return calibration_of(self.checkpoint.manifest["uncertainty"], self.layout)

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
            and not _own(state)
        )

    def native_step(self, state: State, control: Array) -> State:
        """The state after a step; torch's own where `NativeStep` takes no such numbers."""
        arrays = [state.qpos, state.qvel, state.act]
        memory = state.memory.get(MEMORY, self._fresh)
        if memory.shape != self._fresh.shape:
            memory = self._fresh
        found = self.native(*arrays, control, memory)
        if found is None:
            return self.state(state, self.run(state, control[:, None], 1), self.layout.timestep)
        *arrays, memory = found
        qpos, qvel, act, memory = (a.astype(np.float64) for a in (*arrays, memory))
        kept = {name: value for name, value in state.memory.items() if name not in STALE}
        time = state.time + self.layout.timestep
        return State(time, qpos, qvel, act, {**kept, MEMORY: memory})

    def corrected(self, state: State, predicted: State, control: Array) -> Steps:
        """The classical prediction [B] for the next state, corrected by the model."""
        with torch.no_grad():
            model = self.stepper.model
            x, base = model.completed(self.entities(state)), self.entities(predicted)
            memory, context = self.memory(state), self.context(state)
            step = model(x, memory, tensor(control, self.device), context, base=base)
            return Steps(Entities(*(field[None] for field in step.state)), step.memory)

    @property
    def recorded(self) -> bool:
        """Whether steps with gradients, since the first, are played back from graphs."""
        return isinstance(self._exact, DifferentiableStep) and self._exact.recorded

    def _step_exactly(
        self, x: Entities, memory: Tensor, control: Tensor, context: Context
    ) -> tuple[Entities, Tensor]:
        """With gradients, in float32; on a GPU by graphs."""
        if self._exact is None:
            model = self.checkpoint.model.to(self.device).requires_grad_(False)
            self._exact = plain_step(model)
            if self.device.type == "cuda":
                compiler = self.stepper.speedups.compiled
                self._exact = DifferentiableStep(model, self.device, compiler)
        found: tuple[Entities, Tensor] = self._exact(x, memory, control, context)
        return found

    def memory(self, state: State) -> Tensor:
        """The recurrent memory that a state carries, or a fresh one."""
        fresh = self.stepper.initial_memory(state.nworld)
        given = state.memory.get(MEMORY)
        if given is None or tuple(given.shape) != tuple(fresh.shape):
            return fresh
        return tensor(given, self.device).to(fresh.dtype)

    def context(self, state: State) -> Context:
        """The descriptors of each world: the state's own, or the scene's, always the same one."""
        if not _own(state):
            return self._scene(state.nworld).given
        attributes = tensor(state.memory.get(ATTRIBUTES, self._attributes), self.device)
        settings = tensor(state.memory.get(SETTINGS, self._settings), self.device)
        return self._spread(attributes, settings, state.nworld)

    def described(self, state: State) -> Context:
        """`context` as the stepper takes it (see `Stepper.described`); the scene's is made once."""
        if _own(state):
            return self.stepper.described(self.context(state))
        return self._scene(state.nworld).described

    def _scene(self, count: int) -> Descriptors:
        """Those of the scene, for so many worlds; threads may ask for different numbers."""
        found = self._scenes
        if found is None or len(found.given.attributes) != count:
            given = self._spread(self._attributes, self._settings, count)
            found = self._scenes = Descriptors(given, self.stepper.described(given))
        return found

    def _spread(self, attributes: Tensor, settings: Tensor, count: int) -> Context:
        return Context(
            attributes.expand(count, *self._attributes.shape[1:]),
            settings.expand(count, self._settings.shape[1]),
            None,
            None if self._parts is None else self._parts.expand(count, *self._parts.shape[1:]),
        )


def _own(state: State) -> bool:
    """Whether its worlds have descriptors of their own."""
    return ATTRIBUTES in state.memory or SETTINGS in state.memory


def parts_of(scene: Scene, layout: Layout, device: torch.device) -> Tensor | None:
    """[1, P, D] what a model is conditioned on of a scene's parts or limbs; None without."""
    if not layout.parts:
        return None
    if layout.articulated:
        rows = limb_rows(scene.model, scene.source)
    else:
        rows = read_parts(scene.model, layout, scene.source)
    return torch.as_tensor(rows, dtype=torch.float32).to(device)[None]
