"""`LearnedBackend`: OrbiSim-Dynamics as a backend like any other."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch

from orbisim.backend import Backend, Capability, Intervals
from orbisim.errors import InputError, MissingDependencyError, UnsupportedSceneError
from orbisim.host.progress import patient
from orbisim.scene import Scene
from orbisim.state import Array, State
from orbisim.trajectory import Trajectory
from orbisim_world_model import zoo
from orbisim_world_model.arrays import like
from orbisim_world_model.engine import ATTRIBUTES, SETTINGS, Engine
from orbisim_world_model.entities import Entities, Hand
from orbisim_world_model.families import AnyFit, engine_for, fit_any, read_any
from orbisim_world_model.guard import blanked
from orbisim_world_model.native.translate import UntranslatableError
from orbisim_world_model.policy_update import PolicyUpdate
from orbisim_world_model.properties import DENSITY, Values, volume, with_object, with_world
from orbisim_world_model.spread import LEVEL
from orbisim_world_model.stepper import Speedups
from orbisim_world_model.stepping import MEMORY, Stepping
from orbisim_world_model.watch import (
    OUTSIDE,
    UNCERTAINTY,
    UNSURE,
    OutsideTrainingWarning,
    UncertainPredictionWarning,
    Watch,
    as_kind,
)

__all__ = ["LearnedBackend", "OutsideTrainingWarning", "UncertainPredictionWarning"]


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
        self._folder = zoo.located(argument) if argument else None
        self._half, self._native, self._compiled = half, native, compiled
        self._engine: Stepping | None = None
        self._ran = False

    @property
    def timestep(self) -> float:
        """Duration of one step, s: the control step of the training data."""
        return float(self.stepping.layout.timestep)

    @property
    def stepping(self) -> Stepping:
        """The checkpoint on its device, of whatever kind.

        Raises:
          InputError: no scene was loaded.
        """
        _ = self.scene
        assert self._engine is not None
        return self._engine

    @property
    def engine(self) -> Engine:
        """The checkpoint on its device, of robots and objects.

        Raises:
          InputError: no scene was loaded.
          UnsupportedSceneError: the checkpoint is of a cloth, which has no descriptors.
        """
        found = self.stepping
        if not isinstance(found, Engine):
            raise UnsupportedSceneError(
                self.scene.source, "a learned cloth has no robot, objects or descriptors"
            )
        return found

    @property
    def checkpoint(self) -> Any:
        """The checkpoint in use."""
        return self.stepping.checkpoint

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
            self._check(read_any(folder), folder)
            speedups = Speedups(
                precision="fp16" if self._half else "fp32",
                compiled="joined" if self._compiled else None,
            )
            self._engine = engine_for(folder, found, self._on, speedups)
        assert self._engine is not None
        self._engine.describe(scene)
        self._compiles = self._native is not False and self.baseline == "none"
        if self._native:
            self._compile(self._engine)
        self._scene = scene
        self.watch = Watch(self._engine, f"backend {self.name!r}, scene {scene.name!r}")
        for concern in found.concerns:
            self.watch.warn(concern)

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
        seconds = nstep * self.timestep
        if state.nworld == 1 and isinstance(state.qpos, np.ndarray):
            self._compile(self.stepping)
        if self.stepping.suits_native(state, control):
            return self._stepped_natively(state, control, nstep)
        with self._first_time():
            path = self.stepping.run(state, control[:, None], nstep)
        verdict = self.watch.verdict(state, path, self.timestep)
        if verdict.error is not None:
            raise verdict.error
        verdict.memory.pop(UNCERTAINTY, None)  # the state's own memory has it
        return self.stepping.state(state, path, seconds).with_memory(**verdict.memory)

    def rollout(
        self,
        state: State,
        controls: Array,
        *,
        nstep: int = 1,
        sensors: bool = True,
        raise_on_divergence: bool = False,
    ) -> Trajectory:
        """Applies a sequence of controls open-loop, without leaving the device.

        What is noticed on the way is warned of at the end: `OutsideTrainingWarning` names world,
        step and entity. The last state's memory has it as numbers (see `watch`).
        """
        controls, nstep = self.check_rollout(state, controls, nstep)
        if not controls.shape[1]:
            self.watch.began(state)
            return self._trajectory(state, controls, [], np.full(state.nworld, -1), sensors)
        with self._first_time():
            path = self.stepping.run(state, controls, nstep)
        self.watch.controls(state, controls, path, nstep, self.timestep)
        verdict = self.watch.verdict(state, path, self.timestep)
        if raise_on_divergence and verdict.error is not None:
            raise verdict.error
        diverged_at, memory = verdict.diverged_at, dict(verdict.memory)
        if nstep > 1:
            path, diverged_at = path.every(nstep), diverged_at // nstep  # -1 stays -1
            if UNCERTAINTY in memory:
                memory[UNCERTAINTY] = memory[UNCERTAINTY][:, nstep - 1 :: nstep]
        path = path._replace(states=blanked(path.states, diverged_at))
        duration = nstep * self.timestep
        found = self.stepping.trajectory(state, controls, path, diverged_at, duration)
        return dataclasses.replace(found, final=found.final.with_memory(**memory))

    def uncertainty(self, result: State | Trajectory) -> Array | None:
        """Half-widths of the 90 % intervals of positions, m, and rotations, rad.

        Args:
          result: a state, or what a rollout gave.

        Returns:
          [nworld, K, 2] of a state, [nworld, T, K, 2] of a rollout; K entities as `entity_names`,
          of the robot its hand. None if the checkpoint predicts none.
        """
        if isinstance(result, Trajectory):
            return result.final.memory.get(UNCERTAINTY)
        width = self.stepping.interval(self.stepping.variance(result))
        return None if width is None else like(width, result.qpos)

    def intervals(self, trajectory: Trajectory) -> Intervals | None:
        """`uncertainty` of the hand, if there is one, and the objects, each by its frame."""
        widths = self.uncertainty(trajectory)
        if widths is None:
            return None
        layout, host = self.engine.layout, as_kind(widths, np.zeros(0))
        if layout.has_robot and not layout.hand:
            host = host[:, :, 1:]  # of joints, which have no frame
        hand = (("site", layout.hand),) if layout.hand else ()
        frames = (*hand, *(("body", name) for name in layout.objects))
        return Intervals(frames, LEVEL, host[..., 0], host[..., 1])

    @property
    def surface(self) -> str:
        """The geom whose friction is the world setting `friction_slide`; empty if there is none."""
        return self.engine.layout.surface

    @property
    def entity_names(self) -> tuple[str, ...]:
        """`robot`, if there is one, and the objects."""
        return self.stepping.guard.names

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

    def with_properties(
        self,
        state: State,
        objects: Mapping[str, Values] | None = None,
        world: Values | None = None,
    ) -> State:
        """The state in worlds whose objects or surroundings have other properties, by name.

        Values may differ from world to world and carry gradients (see `properties.with_object`).

        Args:
          state: where they go, into its memory; what it has there already is changed.
          objects: by object `mass`, `density`, `friction_slide` ...
          world: `friction_slide` of the surface, `gravity_z` ...

        Raises:
          UnknownNameError: there is no such object or property.
          InputError: a value makes no sense, or the property cannot be changed alone.
        """
        context, layout = self.engine.context(state), self.engine.layout
        attributes, settings = context.attributes, with_world(context.world, layout, world or {})
        for name, changes in (objects or {}).items():
            attributes = with_object(attributes, layout, name, changes)
        return self.with_descriptors(state, attributes=attributes, settings=settings)

    def trained(self, target: str, name: str) -> tuple[float, float] | None:
        """Between which values of a property the checkpoint was trained; None if that is unknown.

        Args:
          target: an object, or the surface. name: as `with_properties` takes it.
        """
        layout, ranges = self.engine.layout, self.checkpoint.manifest["ranges"]
        if target == layout.surface:
            found = ranges.get("settings", {}).get(name)
        else:
            found = ranges.get("attributes", {}).get("mass" if name == DENSITY else name)
        if found is None or target not in (layout.surface, *layout.objects):
            return None
        low, high = map(float, found)
        if name != DENSITY:
            return low, high
        rows = self.engine.context(self.reset(1)).attributes[:, layout.objects.index(target)]
        size = float(volume(rows, layout.attributes))
        return low / size, high / size

    def entities(self, state: State) -> Entities:
        """The state as the model sees it: robot, hand and objects, with gradients to the state."""
        x: Entities = self.engine.stepper.model.completed(self.engine.entities(state))
        return x

    def hand(self, state: State) -> Hand:
        """Pose and velocity of the robot's hand, with gradients to the state.

        Raises:
          UnsupportedSceneError: the scene has no robot whose hand is known.
        """
        if not self.engine.layout.hand:
            raise UnsupportedSceneError(self.scene.source, "there is no hand of a robot")
        x = self.entities(state)
        return Hand(x.hand_pos, x.hand_rot, x.hand_vel, x.hand_ang)

    def policy_update(
        self,
        state: State,
        policy: torch.nn.Module,
        loss: Callable[[Entities], torch.Tensor],
        *,
        window: int,
        rate: float = 1e-3,
    ) -> PolicyUpdate:
        """What updates a policy by the gradient through a window of steps, many times a second.

        Each call of the result, with `entities(state)` of as many worlds, is one update.

        Args:
          state: worlds and their descriptors.
          policy: a module from `Entities` to controls [nworld, nu].
          loss: from the `Entities` at the window's end to [nworld].
          window: control steps. rate: of AdamW.

        Raises:
          UnsupportedSceneError: the checkpoint is of a cloth.
          InputError: an argument is none that `PolicyUpdate` takes.
        """
        engine = self.engine
        return PolicyUpdate(
            engine.checkpoint.model,
            policy,
            loss,
            engine.context(state),
            engine.device,
            window=window,
            rate=rate,
            compiler=engine.stepper.speedups.compiled,
        )

    # -- inner workings ------------------------------------------------------------------------

    def _find(self, scene: Scene) -> tuple[Path, AnyFit]:
        if self._folder is None:
            return zoo.find(scene, self.baseline)
        return self._folder, fit_any(read_any(self._folder), scene)

    @contextlib.contextmanager
    def _first_time(self) -> Iterator[None]:
        """The first step of a checkpoint may be compiled, which is said if it takes long."""
        if self._ran:
            yield
            return
        with patient(f"the first step of backend {self.name!r}, which may be compiled"):
            yield
        self._ran = True

    def _compile(self, engine: Stepping) -> None:
        """Prepares the native step, once; without a compiler only if it was asked for."""
        if engine.native is not None or not self._compiles:
            return
        self._compiles = False
        try:
            with patient("compiling the learned step in C (kept on disk)"):
                engine.prepare_native()
        except (MissingDependencyError, UntranslatableError):
            if self._native:
                raise

    def _check(self, manifest: dict[str, Any], folder: Path) -> None:
        """Refuses checkpoints whose predictions are not a state of the scene."""
        known = manifest["model"]
        baseline = known.get("baseline", "none")
        if baseline != self.baseline:
            other = "learned" if baseline == "none" else "hybrid"
            raise InputError(f"{folder}: a checkpoint for the backend {other!r}")
        if not known.get("extended", True) or known.get("control", "ctrl") != "ctrl":
            raise InputError(
                f"{folder}: predicts the paper's state (no joints, no angular velocity) "
                "from the task's actions; a simulator needs a checkpoint with the extended state "
                "and the actuators' controls, such as configuration 'default'"
            )

    def _stepped_natively(self, state: State, control: Array, nstep: int) -> State:
        """`step` by compiled C; what is within all bounds needs no closer look."""
        watch, engine = self.watch, self.stepping
        for _ in range(nstep):
            known = {OUTSIDE: as_kind(watch.began(state), state.qpos)}
            if engine.spreads:
                known[UNSURE] = as_kind(watch.unsure(state), state.qpos)
            after = engine.native_step(state, control).with_memory(**known)
            if not watch.calm(after):
                verdict = watch.verdict(state, engine.as_steps(after), self.timestep)
                if verdict.error is not None:
                    raise verdict.error
                after = after.with_memory(**{name: verdict.memory[name] for name in known})
            state = after
        return state


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
        raise InputError(
            f"this machine has no device {name!r} (see: orbisim doctor); use device 'cpu'"
        )
    return device
