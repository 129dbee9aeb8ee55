"""Runs a backend on the state held in an MjData and mirrors the result into it."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.agreement import FirstSteps, checkable
from orbisim.backend import Backend
from orbisim.errors import InputError
from orbisim.physics.mjdata import acceleration_sensors, read_state, write_state
from orbisim.physics.watch import ModelWatch
from orbisim.state import State

Floats = npt.NDArray[np.float64]

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
      verify: whether to compare the backend's first steps with C MuJoCo's
        (see `orbisim.agreement`).
    """

    def __init__(self, backend: Backend, physics: Any, *, verify: bool = True) -> None:
        self.backend = backend
        self._first_steps = FirstSteps(backend) if verify and checkable(backend) else None
        self._physics = physics
        self._left: State | None = None
        self._watch = ModelWatch(physics.model.ptr)
        backend.report = backend.reportable

    def copy_for(self, physics: Any) -> Mirror:
        """A mirror of the same backend for a copy of the physics."""
        mirror = Mirror(self.backend, physics, verify=self._first_steps is not None)
        mirror._left = self._left
        return mirror

    def state(self) -> State:
        """The state as the backend would be given it now."""
        state = read_state(self._data)
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
        control = np.array(self._data.ctrl)[None]
        before = self.state()
        after = self.backend.step(before, control, steps)
        self._verify(before, control, nstep, after)
        self._accept(after)

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
            if self._first_steps is not None:
                self._first_steps.restart(reloaded=True)

    def _verify(self, before: State, control: Floats, nstep: int, after: State) -> None:
        """Compares the first steps after the state was set, and a few later ones."""
        if self._first_steps is None:
            return
        if self._left is None or not _same_physical(before, self._left):
            self._first_steps.restart()
        if self._first_steps.due():
            self._first_steps.check(before, control, nstep, after)

    def _backend_steps(self, nstep: int) -> int:
        ratio = nstep * float(self._model.opt.timestep) / self.backend.timestep
        if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < 1:
            raise InputError(
                f"backend {self.backend.name!r} advances {self.backend.timestep:g} s at a time; "
                f"{nstep} timesteps of {self._model.opt.timestep:g} s are not a multiple of it; "
                f"{self._remedy()}"
            )
        return round(ratio)

    def _remedy(self) -> str:
        """What to call instead, where a whole number of timesteps makes a step of the backend."""
        steps = self.backend.timestep / float(self._model.opt.timestep)
        if abs(steps - round(steps)) > 1e-6:
            return f"load the scene with a timestep that divides {self.backend.timestep:g} s"
        return f"call physics.step({round(steps)}), or a multiple of that"

    def _accept(self, state: State) -> None:
        host = state.numpy()
        write_state(self._data, host)
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


def _same_physical(a: State, b: State) -> bool:
    return all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for name in ("time", "qpos", "qvel", "act")
    )
