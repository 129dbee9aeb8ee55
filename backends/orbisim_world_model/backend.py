"""`LearnedBackend`: OrbiSim-Dynamics as a backend like any other."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch

from orbisim.backend import Backend, Capability
from orbisim.errors import DivergedError, InputError, MissingDependencyError
from orbisim.scene import Scene
from orbisim.state import Array, State
from orbisim.trajectory import Trajectory
from orbisim_world_model import zoo
from orbisim_world_model.checkpoint import Checkpoint, load_checkpoint
from orbisim_world_model.engine import ATTRIBUTES, MEMORY, SETTINGS, Engine, Steps
from orbisim_world_model.fitting import Fit, fit
from orbisim_world_model.guard import blanked
from orbisim_world_model.manifest import read_manifest
from orbisim_world_model.native.translate import UntranslatableError
from orbisim_world_model.stepper import Speedups


class OutsideTrainingWarning(UserWarning):
    """A scene or a state lies outside what a checkpoint was trained on."""


class LearnedBackend(Backend):
    """Steps a scene with a learned model; one step is one control step of its training data.

    The recurrent memory is in `State.memory`. Descriptors may differ from world to world and
    carry gradients: `with_descriptors` puts them into a state.

    Args:
      nworld: number of worlds to prepare for.
      device: `cpu`, `cuda`, `cuda:1`; None for the GPU, if there is one.
      argument: folder of a checkpoint (`learned:PATH`); the zoo's that fits the scene if None.
      half: on a GPU, compute the network in half precision.
      compiled: on a GPU, compile the step by torch: many times fewer kernels, after some tens of
        seconds for the first step of each number of worlds (less once torch has it in its cache).
      native: on a CPU, step single worlds by compiled C (see `native`): many times faster, after
        some seconds for the first step of the first time. None: if there is a C compiler.
    """

    name = "learned"
    capabilities = frozenset({Capability.DIFFERENTIABLE, Capability.DEVICE_BATCH})
    baseline = "none"
    perturbation = 1e-2  # the network computes in float32, on a GPU in half precision

    def __init__(
        self,
        *,
        nworld: int = 1,
        device: str | None = None,
        argument: str | None = None,
        half: bool = True,
        native: bool | None = None,
        compiled: bool = True,
    ) -> None:
        super().__init__(nworld=nworld, device=device)
        self._on = _device(device)
        self._folder = Path(argument) if argument else None
        self._half, self._native, self._compiled = half, native, compiled
        self._engine: Engine | None = None

    @property
    def timestep(self) -> float:
        """Duration of one step, s: the control step of the training data."""
        return self.engine.layout.timestep

    @property
    def engine(self) -> Engine:
        """The checkpoint on its device.

        Raises:
          InputError: no scene was loaded.
        """
        _ = self.scene
        assert self._engine is not None
        return self._engine

    @property
    def checkpoint(self) -> Checkpoint:
        """The checkpoint in use."""
        return self.engine.checkpoint

    def load(self, scene: Scene) -> None:
        """Finds the checkpoint and takes the scene's descriptors.

        What lies outside the checkpoint's training data is warned of, by name.

        Raises:
          UnsupportedSceneError: no checkpoint can step this scene.
          InputError: it is no scene, or the checkpoint cannot be read.
        """
        self.check_scene(scene)
        folder, found = self._find(scene)
        now = None if self._engine is None else self._engine.checkpoint
        if now is None or now.path != folder or now.layout != found.layout:
            checkpoint = load_checkpoint(folder, found.layout, found.variant)
            self._check(checkpoint)
            speedups = Speedups(
                precision="fp16" if self._half else "fp32",
                compiled="fused" if self._compiled else None,
            )
            self._engine = Engine(checkpoint, self._on, speedups)
        assert self._engine is not None
        self._engine.describe(scene)
        self._compiles = self._native is not False and self.baseline == "none"
        if self._native:
            self._compile(self._engine)
        self._scene = scene
        self._warn(f"scene {scene.name!r}", found.concerns)

    def reset(self, nworld: int | None = None, seed: int | None = None) -> State:
        """The first keyframe, or the reference configuration, in every world."""
        data = mujoco.MjData(self.model)
        if self.model.nkey:
            mujoco.mj_resetDataKeyframe(self.model, data, 0)
        one = State(
            np.zeros(1), data.qpos[None].copy(), data.qvel[None].copy(), data.act[None].copy()
        )
        return one.tile(self.check_reset(nworld, seed))

    def step(self, state: State, control: Array | None = None, nstep: int = 1) -> State:
        """Advances every world by `nstep` control steps under a constant control."""
        control, nstep = self.check_step(state, control, nstep)
        self._check_start(state)
        seconds = nstep * self.timestep
        if state.nworld == 1 and isinstance(state.qpos, np.ndarray):
            self._compile(self.engine)
        if self.engine.suits_native(state, control):
            after = self.engine.native_step(state, control, nstep, seconds)
            if after is not None:
                return after
        path = self.engine.run(state, control[:, None], nstep)
        self._raise_if_lost(path)
        return self.engine.state(state, path, seconds)

    def rollout(
        self,
        state: State,
        controls: Array,
        *,
        nstep: int = 1,
        sensors: bool = True,
        raise_on_divergence: bool = False,
    ) -> Trajectory:
        """Applies a sequence of controls open-loop, without leaving the device."""
        controls, nstep = self.check_rollout(state, controls, nstep)
        self._check_start(state)
        if not controls.shape[1]:
            return self._trajectory(state, controls, [], np.full(state.nworld, -1), sensors)
        path = self.engine.run(state, controls, nstep)
        diverged_at = self.engine.guard.diverged_at(path.states)
        if raise_on_divergence:
            self.raise_diverged(diverged_at)
        path = path._replace(states=blanked(path.states, diverged_at))
        duration = nstep * self.timestep
        return self.engine.trajectory(state, controls, path, diverged_at, duration)

    def burn_in(self, past: Trajectory) -> State:
        """The state at the end of a trajectory, with the memory of having seen all of it.

        Args:
          past: of any backend, with one record for each of this backend's steps.
        """
        qpos, qvel, act = (past.with_initial(name) for name in ("qpos", "qvel", "act"))
        memory: dict[str, Any] = {}
        for t in range(past.nstep):
            seen = State(past.initial.time, qpos[:, t], qvel[:, t], act[:, t], memory)
            after = self.step(seen, self.check_controls(seen, past.control)[:, t])
            memory = {MEMORY: after.memory[MEMORY]}
        return past.final.with_memory(**memory)

    def with_descriptors(
        self, state: State, *, attributes: Array | None = None, settings: Array | None = None
    ) -> State:
        """The state in worlds with descriptors of their own, which may carry gradients.

        Args:
          state: where they go, into its memory.
          attributes: [nworld, N, D] with the columns `checkpoint.layout.attributes`.
          settings: [nworld, W] with the columns `checkpoint.layout.settings`.

        Raises:
          InputError: they have another shape.
        """
        layout, count = self.engine.layout, state.nworld
        expected = {
            ATTRIBUTES: (attributes, (count, len(layout.objects), len(layout.attributes))),
            SETTINGS: (settings, (count, len(layout.settings))),
        }
        for name, (values, shape) in expected.items():
            if values is not None and tuple(values.shape) != shape:
                raise InputError(f"{name} has shape {tuple(values.shape)}; expected {shape}")
        return state.with_memory(
            **{name: values for name, (values, _) in expected.items() if values is not None}
        )

    # -- inner workings ------------------------------------------------------------------------

    def _find(self, scene: Scene) -> tuple[Path, Fit]:
        if self._folder is None:
            return zoo.find(scene, self.baseline)
        return self._folder, fit(read_manifest(self._folder), scene)

    def _compile(self, engine: Engine) -> None:
        """Prepares the native step, once; without a compiler only if it was asked for."""
        if engine.native is not None or not self._compiles:
            return
        self._compiles = False
        try:
            engine.prepare_native()
        except (MissingDependencyError, UntranslatableError):
            if self._native:
                raise

    def _check(self, checkpoint: Checkpoint) -> None:
        """Refuses checkpoints whose predictions are not a state of the scene."""
        config = checkpoint.model.config
        if config.baseline != self.baseline:
            other = "learned" if config.baseline == "none" else "hybrid"
            raise InputError(f"{checkpoint.path}: a checkpoint for the backend {other!r}")
        if not config.extended or config.control != "ctrl":
            raise InputError(
                f"{checkpoint.path}: predicts the paper's state (no joints, no angular velocity) "
                "from the task's actions; a simulator needs a checkpoint with the extended state "
                "and the actuators' controls, such as configuration 'default'"
            )

    def _raise_if_lost(self, path: Steps) -> None:
        lost = self.engine.guard.diverged_at(path.states) >= 0
        worlds = np.flatnonzero(lost)
        if worlds.size:
            raise DivergedError(
                f"backend {self.name!r}: {worlds.size} of {len(lost)} worlds diverged in scene "
                f"{self.scene.name!r}, world {int(worlds[0])} first; the state is probably "
                "outside what the checkpoint was trained on",
                worlds.tolist(),
            )

    def _check_start(self, state: State) -> None:
        if MEMORY not in state.memory:  # it comes from elsewhere
            x = self.engine.entities(state)
            self._warn(
                f"state of scene {self.scene.name!r}", self.engine.guard.concerns(x.detach())
            )

    def _warn(self, where: str, concerns: Any) -> None:
        for concern in concerns:
            text = f"backend {self.name!r}, {where}: {concern}"
            warnings.warn(text, OutsideTrainingWarning, stacklevel=3)


def _device(name: str | None) -> torch.device:
    """The device of this name.

    Raises:
      InputError: there is none.
    """
    if name is None:
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        raise InputError(f"unknown device {name!r}; expected cpu, cuda or cuda:1") from None
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise InputError(f"this machine has no device {name!r}")
    return device
