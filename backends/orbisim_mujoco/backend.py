"""C MuJoCo, many worlds on all cores."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import mujoco.batch
import numpy as np
import numpy.typing as npt

from orbisim.backend import Backend, Capability, Linearization
from orbisim.effects.base import Hook
from orbisim.effects.carry import hooks_of
from orbisim.effects.stepping import step_batch
from orbisim.errors import CapacityError, DivergedError, InputError
from orbisim.host.cpus import usable_cpus
from orbisim.scene import Scene
from orbisim.state import MEMORY, State
from orbisim.trajectory import Trajectory

_PHYSICAL = ("time", "qpos", "qvel", "act")
_TIME = int(mujoco.mjtState.mjSTATE_TIME)
_DIVERGED = [
    int(mujoco.mjtWarning.mjWARN_INERTIA),  # the step used another matrix than the scene's
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
    int(mujoco.mjtWarning.mjWARN_BADCTRL),
]
_FULL = [int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL)]


class MujocoBackend(Backend):
    """C MuJoCo in float64 through `mujoco.batch`, one thread per core.

    Args:
      nworld: number of worlds to prepare for.
      device: `cpu` or None.
      nthread: number of threads; 0 for one per usable core.
      hooks: makes hooks for a model that is loaded, besides those of the effects that it carries.
    """

    name = "mujoco"
    capabilities = frozenset(
        {Capability.CLASSICAL, Capability.DETERMINISTIC, Capability.CONTACT_FORCES}
    )
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
        }
    )

    def __init__(
        self,
        *,
        nworld: int = 1,
        device: str | None = None,
        nthread: int = 0,
        hooks: Callable[[mujoco.MjModel], Sequence[Hook]] | None = None,
    ) -> None:
        if device not in (None, "cpu"):
            raise InputError(f"backend 'mujoco' runs on the CPU only; got device {device!r}")
        super().__init__(nworld=nworld, device="cpu")
        self._nthread = nthread
        self._further_hooks = hooks
        self._batch: mujoco.batch.Batch | None = None

    def load(self, scene: Scene) -> None:
        """Prepares to simulate `scene`; every scene that MuJoCo compiles is supported."""
        self.check_scene(scene)
        self._hooks = hooks_of(scene.model)
        if self._further_hooks is not None:
            self._hooks += self._further_hooks(scene.model)
        self._scene = scene
        self._batch = None

    def reset(self, nworld: int | None = None, seed: int | None = None) -> State:
        """The model's reference configuration (`mj_resetData`) in every world."""
        batch = self._batch_of(self.check_reset(nworld, seed))
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
        return self._read(batch, reported=False)

    def step(self, state: State, control: Any = None, nstep: int = 1) -> State:
        """`mj_step` in every world, `nstep` times."""
        control, nstep = self.check_step(state, control, nstep)
        batch = self._write(state)
        for name in self.report:
            batch.bind(name)
        batch.warning[:] = 0
        step_batch(self.model, batch, self._hooks, control, nstep)
        self._check(_raised(batch))
        return self._read(batch)

    def rollout(
        self,
        state: State,
        controls: Any,
        *,
        nstep: int = 1,
        sensors: bool = True,
        raise_on_divergence: bool = False,
    ) -> Trajectory:
        """Applies a sequence of controls open-loop, all worlds in parallel threads."""
        if self._hooks:  # they act between timesteps
            return super().rollout(
                state,
                controls,
                nstep=nstep,
                sensors=sensors,
                raise_on_divergence=raise_on_divergence,
            )
        controls, nstep = self.check_rollout(state, controls, nstep)
        if not controls.shape[1]:
            return self._trajectory(state, controls, [], np.full(state.nworld, -1), sensors)
        batch = self._write(state)
        held = controls if nstep == 1 else np.repeat(controls, nstep, axis=1)
        fields: list[Any] = [_TIME, "qpos", "qvel", "act"]
        if sensors and self.model.nsensordata:
            fields.append("sensordata")
        batch.warning[:] = 0
        records = batch.rollout(held.shape[1], held, record=fields)
        time = records[_TIME][..., 0]
        raised = _raised(batch)
        self._check_capacity(raised)
        diverged = np.asarray(raised[:, _DIVERGED].any(axis=1))
        diverged_at = _first_unusable(state.time, time, diverged)
        for name in ("qpos", "qvel", "act", "sensordata"):
            if name in records:
                _blank_after(records[name], diverged_at)
        every = slice(nstep - 1, None, nstep)
        diverged_at = np.where(diverged_at >= 0, diverged_at // nstep, -1)
        if raise_on_divergence:
            self.raise_diverged(diverged_at)
        return Trajectory(
            initial=state,
            control=controls,
            time=time[:, every],
            qpos=records["qpos"][:, every],
            qvel=records["qvel"][:, every],
            act=records["act"][:, every],
            sensordata=records["sensordata"][:, every] if "sensordata" in records else None,
            diverged_at=diverged_at,
            final=self._read(batch, reported=False),
        )

    def linearize(
        self, state: State, control: Any = None, *, eps: float | None = None
    ) -> Linearization:
        """Derivatives of one step by `mjd_transitionFD` (central differences).

        Scenes that it refuses (Runge-Kutta), or that hooks act on, are differenced step by step.
        """
        if self._hooks or self.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            return super().linearize(state, control, eps=eps)
        control, eps = self.check_linearize(state, control, eps)
        batch, model = self._write(state), self.model
        batch.bind("ctrl")[:] = control
        ndx = 2 * model.nv + model.na
        a = np.empty((state.nworld, ndx, ndx))
        b = np.empty((state.nworld, ndx, model.nu))
        data = mujoco.MjData(model)
        for world in range(state.nworld):
            batch.get_data(world, data)
            mujoco.mjd_transitionFD(model, data, eps, True, a[world], b[world], None, None)
        return Linearization(A=a, B=b)

    def close(self) -> None:
        """Frees the batch and its threads."""
        self._batch = None

    # -- the batch and the state ---------------------------------------------------------------

    def _batch_of(self, nworld: int) -> mujoco.batch.Batch:
        model = self.model
        if self._batch is None or self._batch.nsim != nworld:
            sleeps = bool(model.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_SLEEP))
            threads = self._nthread or min(nworld, usable_cpus())
            self._batch = mujoco.batch.Batch(model, nworld, threads, persistent=sleeps)
            defaults = mujoco.MjData(model)
            self._defaults = {name: np.array(getattr(defaults, name)) for name in MEMORY}
        return self._batch

    def _write(self, state: State) -> mujoco.batch.Batch:
        batch = self._batch_of(state.nworld)
        for name in _PHYSICAL:
            batch.bind(name)[:] = getattr(state, name)
        for name in MEMORY:
            batch.bind(name)[:] = state.memory.get(name, self._defaults[name])
        return batch

    def _read(self, batch: mujoco.batch.Batch, reported: bool = True) -> State:
        memory: dict[str, Any] = {
            name: np.array(batch.bind(name)) for name in MEMORY if self._defaults[name].size
        }
        if reported:
            memory |= {name: np.array(batch.bind(name)) for name in self.report}
        return State(**{name: np.array(batch.bind(name)) for name in _PHYSICAL}, memory=memory)

    def _check(self, raised: npt.NDArray[np.bool_]) -> None:
        if not raised.any():
            return
        self._check_capacity(raised)
        worlds = np.flatnonzero(raised[:, _DIVERGED].any(axis=1))
        if worlds.size:
            kinds = [mujoco.mjtWarning(k).name for k in _DIVERGED if raised[:, k].any()]
            raise DivergedError(
                f"backend 'mujoco': {worlds.size} of {len(raised)} worlds diverged in scene "
                f"{self.scene.name!r} ({', '.join(kinds)}), world {int(worlds[0])} first; "
                "reduce the timestep or the controls",
                worlds.tolist(),
            )

    def _check_capacity(self, raised: npt.NDArray[Any]) -> None:
        full = np.flatnonzero(raised[:, _FULL].any(axis=1))
        if full.size:
            raise CapacityError(
                f"backend 'mujoco': the memory for contacts and constraints is full in world "
                f"{int(full[0])} of scene {self.scene.name!r}; raise <size memory=...> in the MJCF"
            )


def _raised(batch: mujoco.batch.Batch) -> npt.NDArray[np.bool_]:
    """[nworld, kind]: which warnings the last call raised (`batch.warning` is info, count)."""
    raised: npt.NDArray[np.bool_] = batch.warning[:, :, 1] > 0
    return raised


def _first_unusable(
    start: npt.NDArray[Any], time: npt.NDArray[Any], diverged: npt.NDArray[np.bool_]
) -> npt.NDArray[np.int64]:
    """The step of each diverged world that raised a warning.

    A world that raises a warning runs no further and `Batch.rollout` repeats its last record; if
    MuJoCo reset the state in that step, the clock went back with it.
    """
    at = np.full(len(time), -1)
    for world in np.flatnonzero(diverged):
        advance = np.diff(time[world], prepend=start[world])
        stalled = np.flatnonzero(advance <= 0)
        if not stalled.size:
            at[world] = time.shape[1] - 1
        else:
            step = int(stalled[0])
            at[world] = step if advance[step] < 0 or step == 0 else step - 1
    return at


def _blank_after(records: npt.NDArray[Any], diverged_at: npt.NDArray[np.int64]) -> None:
    for world in np.flatnonzero(diverged_at >= 0):
        records[world, diverged_at[world] :] = np.nan
