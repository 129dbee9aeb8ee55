"""MuJoCo-Warp: the same scenes in thousands of worlds on a GPU, and on the CPU for tests."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Literal

import mujoco
import numpy as np
import numpy.typing as npt
import warp as wp

from orbisim.host.engine_log import silenced

if not os.environ.get("ORBISIM_WARP_VERBOSE"):  # before mujoco_warp starts Warp
    wp.config.log_level = wp.LOG_ERROR  # it would list every kernel on standard output
    with silenced():  # that there is no driver of a GPU, it says whatever its level
        wp.init()

import mujoco_warp as mjw

from orbisim.backend import Backend, Capability, one_at_a_time
from orbisim.effects.carry import hooks_of
from orbisim.effects.running import CHANGED_FIELDS, HookRunner, changes_fields
from orbisim.errors import (
    CapacityError,
    DivergedError,
    InputError,
    UnsupportedSceneError,
)
from orbisim.host.progress import patient
from orbisim.scene import Scene
from orbisim.state import MEMORY, State
from orbisim.trajectory import Trajectory
from orbisim_warp import kernels
from orbisim_warp.in_place import InPlace

_PHYSICAL = ("qpos", "qvel", "act")
_MEMORY = tuple(name for name in MEMORY if name != "plugin_state")
_BODY_FORCES = frozenset({"cacc", "cfrc_ext", "cfrc_int"})
_TOO_SMALL = int(
    mjw.OverflowType.NEFC
    | mjw.OverflowType.NJMAX_NNZ
    | mjw.OverflowType.BROADPHASE
    | mjw.OverflowType.NARROWPHASE
    | mjw.OverflowType.CCD
    | mjw.OverflowType.NVMAX
)  # larger buffers help; reaching the solver's iteration limit is no error, as in C MuJoCo
_BROKEN = int(mjw.OverflowType.HFIELD | mjw.OverflowType.CONTACT_MATCH | mjw.OverflowType.TACTILE)
_ATTEMPTS = 6
"""Each doubles the buffers at least: 64 times MuJoCo-Warp's estimate before giving up."""
_TIMESTEPS_OF_A_GRAPH = 20
"""A control step of as many is one CUDA graph; more are launched one by one."""
_LIMIT = float(mujoco.mjMAXVAL)
_OPPOSED = 0.01
"""Share of the forces' power that must be negative before it is not rounding (1e-7 each)."""


class WarpBackend(Backend):
    """MuJoCo-Warp in float32.

    Buffers for contacts and constraints start at MuJoCo-Warp's own estimate and are enlarged (and
    the step repeated) when they overflow. On a GPU, steps run as CUDA graphs; what a rollout is
    recorded into is kept for the next one of the same length.

    Args:
      nworld: number of worlds to prepare for.
      device: `cpu`, `cuda` or `cuda:N`; None for the first GPU, or the CPU where there is none.
      nconmax, njmax: contacts and constraints to allocate for each world; None for an estimate.
      arrays: `numpy` returns NumPy float64 on the host; `torch` returns float32 tensors on the
        device, without copies to the host.
      deterministic: sums contacts and constraints in a fixed order, at some cost.
    """

    name = "warp"
    perturbation = 3e-3  # float32: exact to 1e-5 between 1e-3 and 1e-2
    reportable = frozenset(
        {
            "act_dot",
            "actuator_force",
            "qacc",
            "qacc_smooth",
            "qfrc_actuator",
            "qfrc_constraint",
            "qfrc_smooth",
            "sensordata",
            *_BODY_FORCES,
        }
    )

    _costly = _BODY_FORCES
    _overflows = _TOO_SMALL | _BROKEN

    derivable = frozenset(
        {
            "actuator_length",
            "actuator_velocity",
            "cam_xmat",
            "cam_xpos",
            "cvel",
            "geom_xmat",
            "geom_xpos",
            "sensordata",
            "site_xmat",
            "site_xpos",
            "subtree_com",
            "ten_length",
            "ten_velocity",
            "xaxis",
            "ximat",
            "xipos",
            "xmat",
            "xpos",
            "xquat",
        }
    )

    def __init__(
        self,
        *,
        nworld: int = 1,
        device: str | None = None,
        nconmax: int | None = None,
        njmax: int | None = None,
        arrays: Literal["numpy", "torch"] = "numpy",
        deterministic: bool = False,
    ) -> None:
        if arrays not in ("numpy", "torch"):
            raise InputError(f"arrays is 'numpy' or 'torch'; got {arrays!r}")
        self._wp_device = _device(device)
        super().__init__(nworld=nworld, device=str(self._wp_device))
        self._sizes = {"nconmax": nconmax, "njmax": njmax}
        self._torch = arrays == "torch"
        self._deterministic = deterministic
        self._model: Any = None
        self._data: Any = None
        self._graphs: dict[Any, Any] = {}
        self._kept: tuple[Any, dict[str, wp.array]] | None = None
        capabilities = {Capability.CLASSICAL, Capability.CONTACT_FORCES}
        if self._wp_device.is_cuda:
            capabilities.add(Capability.DEVICE_BATCH)
        if deterministic or self._wp_device.is_cpu:
            capabilities.add(Capability.DETERMINISTIC)
        self.capabilities = frozenset(capabilities)

    def load(self, scene: Scene) -> None:
        """Puts the scene's model on the device.

        Raises:
          InputError: it is no scene.
          UnsupportedSceneError: MuJoCo-Warp does not support something that the scene has.
        """
        self.check_scene(scene)
        try:
            with self._scope(), patient(f"loading {scene.name!r} into MuJoCo-Warp"):
                self._model = mjw.put_model(scene.model)
        except (NotImplementedError, ValueError) as error:
            raise UnsupportedSceneError(
                scene.source, f"MuJoCo-Warp cannot simulate it: {error}", remedy="use 'mujoco'"
            ) from None
        self._hooks = hooks_of(scene.model)
        self._model.opt.warn_overflow = 0  # overflows are noticed, and repaired, here
        if self._deterministic:
            self._model.opt.deterministic = int(mjw.DeterminismType.ALL)
        self._scene = scene
        self._compiled = False
        self._forget()
        self._kept = None
        self._use_report()
        self._solves_implicitly = _may_solve_indefinite(scene.model)
        defaults = self._shapes = mujoco.MjData(scene.model)
        self._defaults = {name: np.array(getattr(defaults, name)) for name in _MEMORY}

    def reset(self, nworld: int | None = None, seed: int | None = None) -> State:
        """The model's reference configuration in every world."""
        count = self.check_reset(nworld, seed)
        data = mujoco.MjData(self.model)

        def repeat(value: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
            return np.repeat(np.array(value, np.float64)[None], count, axis=0)

        state = State(
            time=np.zeros(count),
            qpos=repeat(data.qpos),
            qvel=repeat(data.qvel),
            act=repeat(data.act),
            memory={name: repeat(v) for name, v in self._defaults.items() if v.size},
        )
        return self._to_torch(state) if self._torch else state

    @property
    def report(self) -> frozenset[str]:
        """Derived fields that `step` puts into `State.memory` (see `Backend.report`)."""
        return self._report

    @report.setter
    @one_at_a_time
    def report(self, names: Iterable[str]) -> None:
        Backend.report.fset(self, names)  # type: ignore[attr-defined]
        self._use_report()

    def _use_report(self) -> None:
        if self._model is not None:
            self._model.opt.run_rne_postconstraint = not self._report.isdisjoint(_BODY_FORCES)
        self._graphs = {}

    def step(self, state: State, control: Any = None, nstep: int = 1) -> State:
        """`mujoco_warp.step` in every world, `nstep` times."""
        control, nstep = self.check_step(state, control, nstep)

        def run() -> None:
            self._write(state, control)
            if self._hooks:
                self._step_with_hooks(state, control, nstep)
                return
            self._launch_steps(nstep)

        with self._first_time():
            self._until_it_fits(run, state.nworld)
        return self._finish_step(state, nstep)

    @one_at_a_time
    def forward(self, state: State, control: Any = None, *, actuation: bool = True) -> State:
        """The same state with the derived fields of `report` computed at it (`mj_forward`).

        Args:
          actuation: whether actuators act, as MuJoCo's disable flag of that name.
        """
        control, _ = self.check_step(state, control, 1)
        flags = self._model.opt.disableflags
        if not actuation:
            self._model.opt.disableflags = flags | int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
        try:

            def run() -> None:
                self._write(state, control)
                with self._scope():
                    mjw.forward(self._model, self._data)

            self._until_it_fits(run, state.nworld)
        finally:
            self._model.opt.disableflags = flags
        return state.with_memory(**self._reported())

    @one_at_a_time
    def derive(self, state: State, names: Iterable[str]) -> dict[str, Any]:
        """See `Backend.derive`; on the device, in float32."""
        self.check_step(state, None, 1)
        wanted = sorted(names)
        if unknown := set(wanted) - self.derivable:
            raise InputError(f"backend 'warp' does not derive {', '.join(sorted(unknown))}")

        def run() -> None:
            self._write(state, None)
            self._launch("derive", self._stages)

        self._until_it_fits(run, state.nworld)
        found = {name: self._array(getattr(self._data, name)) for name in wanted}
        shapes = {name: getattr(self._shapes, name).shape for name in wanted}
        return {n: rows.reshape(state.nworld, *shapes[n]) for n, rows in found.items()}

    @one_at_a_time
    def in_place(self, nworld: int) -> InPlace | None:
        """See `Backend.in_place`; None where effects act between timesteps."""
        if self._hooks:
            return None
        engine = WarpBackend(
            nworld=nworld,
            device=self.device,
            nconmax=self._sizes["nconmax"],
            njmax=self._sizes["njmax"],
            deterministic=self._deterministic,
        )
        engine.load(self.scene)
        return InPlace(engine, nworld)

    def _stages(self) -> None:
        """Of positions and velocities."""
        model, data = self._model, self._data
        mjw.fwd_position(model, data, factorize=False)
        data.sensordata.zero_()
        mjw.sensor_pos(model, data)
        mjw.fwd_velocity(model, data)
        mjw.sensor_vel(model, data)

    def rollout(
        self,
        state: State,
        controls: Any,
        *,
        nstep: int = 1,
        sensors: bool = True,
        raise_on_divergence: bool = False,
    ) -> Trajectory:
        """Applies a sequence of controls open-loop, recording on the device."""
        if self._hooks:  # they act between timesteps
            return super().rollout(
                state,
                controls,
                nstep=nstep,
                sensors=sensors,
                raise_on_divergence=raise_on_divergence,
            )
        controls, nstep = self.check_rollout(state, controls, nstep)
        steps = int(controls.shape[1])
        with self._scope():
            buffers = self._buffers_for(controls, state.nworld, steps, sensors)

        def run() -> None:
            self._write(state, controls[:, 0] if steps else None)
            buffers["cursor"].zero_()
            key = ("rollout", nstep, *(buffer.ptr for buffer in buffers.values()))
            for _ in range(steps * nstep):
                self._launch(key, lambda: self._one_recorded_step(buffers, nstep))

        with self._first_time():
            self._until_it_fits(run, state.nworld)
        return self._finish_rollout(state, controls, buffers, nstep, raise_on_divergence)

    def close(self) -> None:
        """Frees the device memory."""
        self._forget()
        self._kept = None
        self._model = None

    @contextlib.contextmanager
    def _first_time(self) -> Iterator[None]:
        """The first step of a scene compiles kernels, which is said if it takes long."""
        if self._compiled:
            yield
            return
        with patient(f"compiling MuJoCo-Warp's kernels for {self.scene.name!r} (kept on disk)"):
            yield
        self._compiled = True

    # -- running -------------------------------------------------------------------------------

    def _timestep(
        self, cursor: wp.array | None = None, advance: Callable[[Any, Any], None] = mjw.step
    ) -> None:
        """One timestep; notes the worlds that are lost in it, and where `cursor` stands then."""
        data = self._data
        cursor = self._no_cursor if cursor is None else cursor
        if self._solves_implicitly:
            wp.copy(self._before, data.qvel)
        advance(self._model, data)
        numbers = [data.qpos, data.qvel, data.qacc, data.act, data.ctrl]
        wp.launch(kernels.note_divergence, data.nworld, [cursor, _LIMIT, *numbers, self._lost])
        if self._solves_implicitly:
            wp.launch(
                kernels.note_negative_inertia,
                data.nworld,
                [cursor, _OPPOSED, self._before, data.qvel, data.efc.Ma, self._lost],
            )

    def _step_with_hooks(self, state: State, control: Any, nstep: int) -> None:
        """Timestep by timestep, with effects that MuJoCo cannot express applied before each."""
        data, nworld = self._data, state.nworld
        runner = HookRunner(self.model, self._hooks)
        applied = {n: _host(getattr(data, n)) for n in ("qfrc_applied", "xfrc_applied")}
        base = {n: np.tile(getattr(self.model, n), (nworld, 1)) for n in runner.fields}
        control = control.detach().cpu().numpy() if hasattr(control, "detach") else control

        def read(name: str) -> npt.NDArray[np.float64]:
            return _host(getattr(data, name))

        with self._scope():
            for _ in range(nstep):
                if runner.derived:
                    mjw.forward(self._model, data)
                inputs = runner.inputs(read, control, applied, base)
                _assign(data.ctrl, inputs.ctrl)
                _assign(data.qfrc_applied, inputs.qfrc)
                _assign(data.xfrc_applied, inputs.xfrc)
                for name, values in inputs.fields.items():
                    _assign(getattr(self._model, name), values)
                self._timestep()
            for name, values in applied.items():
                _assign(getattr(data, name), values)

    def _one_recorded_step(self, buffers: dict[str, wp.array], hold: int) -> None:
        data, cursor = self._data, buffers["cursor"]
        if data.ctrl.size:
            wp.launch(
                kernels.load_control,
                data.ctrl.shape,
                [cursor, hold, buffers["controls"], data.ctrl],
            )
        self._timestep(cursor)
        for name, buffer in buffers.items():
            if name in ("qpos", "qvel", "act", "sensordata"):
                values = getattr(data, name)
                wp.launch(kernels.record, values.shape, [cursor, hold, values, buffer])
        wp.launch(kernels.advance, 1, [cursor])

    def _launch(self, key: Any, work: Callable[[], None]) -> None:
        """Runs `work`, on a GPU as a graph that is captured the second time it is asked for."""
        with self._scope():
            if not self._wp_device.is_cuda:
                work()
            elif key not in self._graphs:
                work()  # loads the kernels; a capture cannot
                self._graphs[key] = None
            else:
                if self._graphs[key] is None:
                    with wp.ScopedCapture() as capture:
                        work()
                    self._graphs[key] = capture.graph
                wp.capture_launch(self._graphs[key])

    def _launch_steps(self, nstep: int) -> None:
        """Many timesteps, as few launches."""
        if nstep <= _TIMESTEPS_OF_A_GRAPH:

            def steps() -> None:
                for _ in range(nstep):
                    self._timestep()

            self._launch(f"step {nstep}", steps)
            return
        for _ in range(nstep):
            self._launch("step", self._timestep)

    def _until_it_fits(self, run: Callable[[], None], nworld: int) -> None:
        """Runs; while a contact or constraint buffer overflows, enlarges it and runs again."""
        for _ in range(_ATTEMPTS):
            self._allocate(nworld)
            run()
            overflow = int(np.bitwise_or.reduce(self._data.overflow.numpy(), initial=0))
            self._may_be_enlarged(overflow)
            if not overflow & _TOO_SMALL:
                return
            self._enlarge(nworld)
        raise CapacityError(
            f"backend 'warp': scene {self.scene.name!r} needs more than {self._sizes['nconmax']} "
            f"contacts or {self._sizes['njmax']} constraints a world; pass nconmax and njmax"
        )

    def _may_be_enlarged(self, overflow: int) -> None:
        """Raises `CapacityError` if something overflowed that has a fixed size."""
        if overflow & _BROKEN:
            raise CapacityError(
                f"backend 'warp': scene {self.scene.name!r} overflows "
                f"{mjw.OverflowType(overflow & _BROKEN)!r}, which cannot be enlarged; use 'mujoco'"
            )

    def _enlarge(self, nworld: int) -> None:
        """Twice the present buffers, or half as much again as the last step asked for."""
        data = self._data
        contacts = int(max(data.nacon.numpy().max(), data.ncollision.numpy().max()))
        rows = int(data.nefc.numpy().max())
        self._sizes = {
            "nconmax": max(2 * -(-data.naconmax // nworld), -(-3 * contacts // (2 * nworld)), 8),
            "njmax": max(2 * data.njmax, 3 * rows // 2, 16),
        }
        self._forget()

    def _allocate(self, nworld: int) -> None:
        if self._data is not None and self._data.nworld == nworld:
            return
        self._forget()
        with self._scope():
            self._data = mjw.make_data(self.model, nworld=nworld, **self._sizes)
            self._data.overflow.zero_()
            self._lost = wp.full(nworld, -1, dtype=int)
            self._no_cursor = wp.zeros(1, dtype=int)
            self._before = wp.zeros((nworld, self.model.nv), dtype=float)
        if changes_fields(self._hooks):
            self._give_worlds_their_own_fields(nworld)

    def _give_worlds_their_own_fields(self, nworld: int) -> None:
        with self._scope():
            for name in CHANGED_FIELDS:
                shared = getattr(self._model, name).numpy()[:1]
                array = wp.array(np.repeat(shared, nworld, axis=0), dtype=float)
                array._is_batched = True
                setattr(self._model, name, array)

    def _forget(self) -> None:
        self._data = None
        self._graphs = {}

    @contextlib.contextmanager
    def _scope(self) -> Iterator[None]:
        with wp.ScopedDevice(self._wp_device):
            yield

    # -- the state -----------------------------------------------------------------------------

    def _write(self, state: State, control: Any) -> None:
        data = self._data
        self._lost.fill_(-1)
        _assign(data.time, state.time)
        for name in _PHYSICAL:
            _assign(getattr(data, name), getattr(state, name))
        for name in _MEMORY:
            target = getattr(data, name)
            if target.size:
                _assign(target, state.memory.get(name, self._defaults[name]))
        if control is not None:
            _assign(data.ctrl, control)

    def _finish_step(self, state: State, nstep: int) -> State:
        memory = {
            name: self._array(getattr(self._data, name))
            for name in _MEMORY
            if self._defaults[name].size
        }
        new = State(
            time=state.time + nstep * self.timestep,
            qpos=self._array(self._data.qpos),
            qvel=self._array(self._data.qvel),
            act=self._array(self._data.act),
            memory={**memory, **self._reported()},
        )
        lost = np.flatnonzero(self._lost.numpy() >= 0)
        if lost.size:
            raise DivergedError(
                f"backend 'warp': {lost.size} of {state.nworld} worlds diverged in scene "
                f"{self.scene.name!r}, world {int(lost[0])} first; reduce the timestep or "
                "the controls",
                lost.tolist(),
            )
        return new

    def _finish_rollout(
        self,
        state: State,
        controls: Any,
        buffers: dict[str, wp.array],
        nstep: int,
        raise_on_divergence: bool,
    ) -> Trajectory:
        records = {
            name: self._array(buffer)
            for name, buffer in buffers.items()
            if name in ("qpos", "qvel", "act", "sensordata")
        }
        nworld, steps = state.nworld, int(controls.shape[1])
        for name, size in (
            ("qpos", self.model.nq),
            ("qvel", self.model.nv),
            ("act", self.model.na),
        ):
            if name not in records:
                records[name] = self._array(wp.zeros((nworld, steps, size), dtype=float))
        lost = self._lost.numpy()
        diverged_at = np.where(lost >= 0, lost // nstep, -1)
        for name in ("qpos", "qvel", "act"):
            for world in np.flatnonzero(diverged_at >= 0):
                records[name][world, diverged_at[world] :] = np.nan
        if raise_on_divergence:
            self.raise_diverged(diverged_at)
        clock = (np.arange(1, steps + 1) * nstep * self.timestep)[None]
        final = State(
            time=state.time + steps * nstep * self.timestep,
            qpos=self._array(self._data.qpos),
            qvel=self._array(self._data.qvel),
            act=self._array(self._data.act),
            memory={
                name: self._array(getattr(self._data, name))
                for name in _MEMORY
                if self._defaults[name].size
            },
        )
        return Trajectory(
            initial=state,
            control=controls,
            time=state.time[:, None] + self._like(clock, state.time),
            sensordata=records.pop("sensordata", None),
            diverged_at=diverged_at,
            final=final,
            **records,
        )

    def _buffers_for(
        self, controls: Any, nworld: int, steps: int, sensors: bool
    ) -> dict[str, wp.array]:
        """Buffers with the controls; those of the last rollout, and its graph, if they fit."""
        key = (nworld, steps, sensors)
        if self._kept is None or self._kept[0] != key:
            self._graphs = {k: g for k, g in self._graphs.items() if not isinstance(k, tuple)}
            self._kept = None  # frees them before others are allocated
            self._kept = (key, self._rollout_buffers(nworld, steps, sensors))
        buffers = self._kept[1]
        if "controls" in buffers:
            _assign(buffers["controls"], controls)
        return buffers

    def _rollout_buffers(self, nworld: int, steps: int, sensors: bool) -> dict[str, wp.array]:
        model = self.model
        sizes = {"qpos": model.nq, "qvel": model.nv, "act": model.na}
        if sensors:
            sizes["sensordata"] = model.nsensordata
        buffers = {
            name: wp.zeros((nworld, steps, size), dtype=float)
            for name, size in sizes.items()
            if size
        }
        buffers["cursor"] = wp.zeros(1, dtype=int)
        if model.nu:
            buffers["controls"] = wp.empty((nworld, steps, model.nu), dtype=float)
        return buffers

    def _reported(self) -> dict[str, Any]:
        return {name: self._array(getattr(self._data, name)) for name in self.report}

    def _array(self, array: wp.array) -> Any:
        """A copy of a device array as this backend returns it."""
        if self._torch:
            return wp.to_torch(array).clone()
        host = array.numpy()
        return host.astype(np.float64) if host.dtype.kind == "f" else host.copy()

    def _to_torch(self, state: State) -> State:
        import torch

        def convert(value: npt.NDArray[Any]) -> Any:
            return torch.as_tensor(
                value, dtype=torch.float32, device=wp.device_to_torch(self._wp_device)
            )

        return State(
            time=convert(state.time).double(),
            **{name: convert(getattr(state, name)) for name in _PHYSICAL},
            memory={name: convert(value) for name, value in state.memory.items()},
        )

    def _like(self, value: npt.NDArray[Any], reference: Any) -> Any:
        if isinstance(reference, np.ndarray):
            return value
        import torch

        return torch.as_tensor(value, dtype=reference.dtype, device=reference.device)


def _device(name: str | None) -> wp.Device:
    if name is None:
        return wp.get_preferred_device()
    try:
        return wp.get_device("cuda:0" if name == "cuda" else name)
    except (ValueError, RuntimeError) as error:
        known = ", ".join(str(device) for device in wp.get_devices())
        raise InputError(
            f"backend 'warp' has no device {name!r}; this machine has {known}"
        ) from error


def _assign(target: wp.array, value: Any) -> None:
    """Copies numbers into a device array of any scalar, vector or quaternion type."""
    shape = (*target.shape, *getattr(target.dtype, "_shape_", ()))
    if hasattr(value, "detach"):
        import torch

        kind = torch.bool if target.dtype is wp.bool else torch.float32
        tensor = value.detach().to(device=wp.device_to_torch(target.device), dtype=kind)
        wp.copy(target, wp.from_torch(tensor.expand(shape).contiguous(), dtype=target.dtype))
        return
    numbers = np.broadcast_to(np.asarray(value), shape)
    dtype = np.bool_ if target.dtype is wp.bool else np.float32
    target.assign(np.ascontiguousarray(numbers, dtype))


def _host(array: wp.array) -> npt.NDArray[np.float64]:
    """A device array on the host in float64."""
    return np.asarray(array.numpy(), np.float64)


def _may_solve_indefinite(model: mujoco.MjModel) -> bool:
    """Whether a step solves for velocities with a matrix that need not be positive definite.

    That is so where something pushes the harder the faster it goes, and is integrated implicitly.
    """
    driven = bool((model.dof_damping < 0).any() or model.dof_dampingpoly.any())
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER:
        return driven
    driven |= bool((model.actuator_biasprm[:, 2] > 0).any() or model.actuator_gainprm[:, 2].any())
    return driven and model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
