"""Runs a backend on the state held in an MjData and mirrors the result into it."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.backend import Backend
from orbisim.errors import InputError
from orbisim.state import State

ACCELERATION_FIELDS = (
    "act_dot",
    "actuator_force",
    "cacc",
    "cfrc_ext",
    "cfrc_int",
    "efc_force",
    "qacc",
    "qacc_smooth",
    "qfrc_actuator",
    "qfrc_constraint",
    "qfrc_inverse",
    "qfrc_smooth",
)
"""Fields of MjData that the acceleration stage computes (besides part of `sensordata`)."""


class Mirror:
    """Keeps the MjData of a dm_control `Physics` in step with a backend.

    The MjData holds the physical state between steps, so that whatever a task writes into it
    counts. What the backend remembers privately lives here, and is dropped when the state in
    MjData is no longer the one that the backend left there.

    Args:
      backend: with the physics' scene loaded.
      physics: a dm_control `Physics`.
    """

    def __init__(self, backend: Backend, physics: Any) -> None:
        self.backend = backend
        self._physics = physics
        self._left: State | None = None
        self._watch = ModelWatch(physics.model.ptr)
        backend.report = backend.reportable

    def copy_for(self, physics: Any) -> Mirror:
        """A mirror of the same backend for a copy of the physics."""
        mirror = Mirror(self.backend, physics)
        mirror._left = self._left
        return mirror

    def state(self) -> State:
        """The state as the backend would be given it now."""
        from orbisim.physics import read_state

        state = read_state(self._model, self._data)
        if self._left is None or not _same_physical(state, self._left):
            return state
        private = {k: v for k, v in self._left.memory.items() if k not in state.memory}
        return state.with_memory(**private)

    def restore(self, state: State) -> None:
        """Takes the private memory of a state that was just written into MjData."""
        self._left = state.numpy()
        self._mirror_stages()
        self._fill_accelerations(state)

    def step(self, nstep: int) -> None:
        """Advances by `nstep` timesteps of the model."""
        self._follow_model()
        steps = self._backend_steps(nstep)
        control = np.array(self._data.ctrl)
        self._accept(self.backend.step(self.state(), control[None], steps))

    def forward(self) -> None:
        """Recomputes derived fields; those of the acceleration stage by the backend."""
        self._follow_model()
        self._mirror_stages()
        forward = getattr(self.backend, "forward", None)
        if forward is None:
            self._fill_accelerations(None)
            return
        actuation = not self._model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
        control = np.array(self._data.ctrl)
        self._fill_accelerations(forward(self.state(), control[None], actuation=actuation))

    def leave(self) -> None:
        """Leaves MjData as C MuJoCo needs it to go on: the same state, its own derived fields."""
        for name in ACCELERATION_FIELDS:  # some are only computed on request
            getattr(self._data, name)[:] = 0.0
        self._data.qacc_warmstart[:] = np.nan_to_num(self._data.qacc_warmstart)
        mujoco.mj_forward(self._model, self._data)

    # -- inner workings ------------------------------------------------------------------------

    @property
    def _model(self) -> mujoco.MjModel:
        model: mujoco.MjModel = self._physics.model.ptr
        return model

    @property
    def _data(self) -> mujoco.MjData:
        data: mujoco.MjData = self._physics.data.ptr
        return data

    def _follow_model(self) -> None:
        """Loads the scene again if a task changed the model since."""
        if self._watch.changed():
            self.backend.load(self._physics.scene)
            self.backend.report = self.backend.reportable

    def _backend_steps(self, nstep: int) -> int:
        ratio = nstep * float(self._model.opt.timestep) / self.backend.timestep
        if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < 1:
            raise InputError(
                f"backend {self.backend.name!r} advances {self.backend.timestep:g} s at a time; "
                f"{nstep} timesteps of {self._model.opt.timestep:g} s are not a multiple of it"
            )
        return round(ratio)

    def _accept(self, state: State) -> None:
        from orbisim.physics import write_state

        host = state.numpy()
        write_state(self._model, self._data, host)
        self._left = host
        self._mirror_stages()
        self._fill_accelerations(host)

    def _mirror_stages(self) -> None:
        """The position and velocity stages, sensors of these stages and energy."""
        mujoco.mj_step1(self._model, self._data)

    def _fill_accelerations(self, reported: State | None) -> None:
        memory = reported.numpy().memory if reported is not None else {}
        for name in ACCELERATION_FIELDS:
            field = getattr(self._data, name)
            if field.size:
                field[:] = memory[name][0] if name in memory else np.nan
        unknown = acceleration_sensors(self._model)
        values = memory["sensordata"][0][unknown] if "sensordata" in memory else np.nan
        self._data.sensordata[unknown] = values


def acceleration_sensors(model: mujoco.MjModel) -> npt.NDArray[np.int64]:
    """Indices into `sensordata` of the sensors computed by the acceleration stage."""
    stage = int(mujoco.mjtStage.mjSTAGE_ACC)
    ranges = [
        np.arange(model.sensor_adr[i], model.sensor_adr[i] + model.sensor_dim[i])
        for i in range(model.nsensor)
        if model.sensor_needstage[i] == stage
    ]
    return np.concatenate(ranges) if ranges else np.zeros(0, np.int64)


def _same_physical(a: State, b: State) -> bool:
    return all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for name in ("time", "qpos", "qvel", "act")
    )


class ModelWatch:
    """Notices when a model's numbers change.

    Looks at every array that enters the dynamics; meshes, textures and skins do not change at run
    time.
    """

    _SKIPPED = (
        "mesh_",
        "tex_",
        "skin_",
        "bvh_",
        "names",
        "paths",
        "text_",
        "tuple_",
        "key_",
        "oct_",
    )

    def __init__(self, model: mujoco.MjModel) -> None:
        self._option = model.opt
        self._arrays = [
            value
            for name in dir(model)
            if not name.startswith(("_", *self._SKIPPED))
            and isinstance(value := getattr(model, name), np.ndarray)
            and value.size
        ]
        self._last = self._snapshot()

    def changed(self) -> bool:
        """Whether anything changed since the last call."""
        snapshot = self._snapshot()
        if snapshot == self._last:
            return False
        self._last = snapshot
        return True

    def _snapshot(self) -> bytes:
        option = self._option
        scalars = (
            option.timestep,
            option.integrator,
            option.disableflags & ~int(mujoco.mjtDisableBit.mjDSBL_ACTUATION),
            option.enableflags,
            option.density,
            option.viscosity,
            *option.gravity,
            *option.wind,
        )
        return repr(scalars).encode() + b"".join(array.tobytes() for array in self._arrays)
