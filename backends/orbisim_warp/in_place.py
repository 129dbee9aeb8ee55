"""Worlds that stay on the device between steps, read and written where MuJoCo-Warp keeps them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from orbisim.physics.mjdata import acceleration_sensors
from orbisim_warp import kernels

_CHANGED_BY_A_STEP = ("time", "qpos", "qvel", "act", "qacc_warmstart", "history")


class InPlace:
    """Steps worlds where they are; see `Backend.in_place`.

    The position and velocity stages of a new state are those that the next step begins with, as in
    dm_control (`mj_step2`, then `mj_step1`): they are computed once.

    Args:
      engine: a `WarpBackend` with the scene loaded; nothing else may use it.
      nworld: number of worlds.

    Attributes:
      device: of the fields, as torch names it.
      generation: grows whenever fields move to other memory.
      names: of the fields that there are.
    """

    def __init__(self, engine: Any, nworld: int) -> None:
        self._engine, self._nworld = engine, nworld
        self.device = wp.device_to_torch(engine._wp_device)
        self.generation = 0
        state = {*_CHANGED_BY_A_STEP, "ctrl", *engine._defaults}
        reported = engine.reportable - engine._costly
        self.names = frozenset(state | engine.derivable | reported)
        self._changed = [n for n in _CHANGED_BY_A_STEP if n in state]
        self._constant = sorted(state - set(self._changed))
        self._in_two = _advances_in_two(engine.model)
        self._accelerations = acceleration_sensors(engine.model)
        self._views: dict[str, Any] = {}
        self._before: dict[str, wp.array] = {}
        engine._allocate(nworld)
        self._prepare()

    def field(self, name: str) -> Any:
        """A field's own memory [nworld, ...], in MjData's shape: no copy."""
        if name not in self._views:
            array = getattr(self._engine._data, name)
            shape = () if name == "time" else getattr(self._engine._shapes, name).shape
            self._views[name] = _tensor(array, self.device).reshape(self._nworld, *shape)
        return self._views[name]

    def _view(self, name: str, array: wp.array) -> Any:
        """An array that is no field; made once, as none can be while a CUDA graph is recorded."""
        if name not in self._views:
            self._views[name] = _tensor(array, self.device)
        return self._views[name]

    @property
    def lost(self) -> Any:
        """[nworld], whether the last step has lost a world."""
        return self._view("_lost", self._engine._lost) >= 0

    @property
    def overflowed(self) -> Any:
        """[], whether a buffer was too small, so that `repair` is needed."""
        bits = self._view("_overflow", self._engine._data.overflow)
        return bits.bitwise_and(self._engine._overflows).any()

    def write(self, worlds: Any, rows: Mapping[str, Any]) -> None:
        """Gives worlds a state; `refresh` is due afterwards.

        Args:
          worlds: their numbers [n], on the device.
          rows: by name, each [n, ...], on the device.
        """
        for name, values in rows.items():
            view = self.field(name)
            view[worlds] = values.to(view.dtype).reshape(len(worlds), *view.shape[1:])

    def refresh(self) -> None:
        """The position and velocity stages of the state that there is."""
        with self._in_order():
            self._engine._launch("stages", self._stages)

    def step(self, nstep: int) -> None:
        """Advances all worlds by `nstep` timesteps under `ctrl`; on a GPU, as one CUDA graph."""
        with self._in_order():
            self._engine._launch(f"in place, {nstep}", lambda: self._advance(nstep))

    @contextlib.contextmanager
    def _in_order(self) -> Iterator[None]:
        """After what torch was asked for, and before what it will be.

        Its default stream waits for Warp's and is waited for, by CUDA's rules; others are not.
        """
        device = self._engine._wp_device
        if not device.is_cuda:
            yield
            return
        import torch

        here = torch.cuda.current_stream(self.device)
        if not here.cuda_stream:
            yield
            return
        theirs, ours = wp.stream_from_torch(here), wp.get_stream(device)
        ours.wait_stream(theirs)
        yield
        theirs.wait_stream(ours)

    def take_back(self) -> None:
        """The state from before the last step."""
        for name, kept in self._before.items():
            wp.copy(getattr(self._engine._data, name), kept)
        self.refresh()

    def repair(self) -> None:
        """Larger buffers, and the state from before the last step; fields have moved.

        Raises:
          CapacityError: what overflowed cannot be enlarged.
        """
        engine, old = self._engine, self._engine._data
        engine._may_be_enlarged(int(np.bitwise_or.reduce(old.overflow.numpy(), initial=0)))
        engine._enlarge(self._nworld)
        engine._allocate(self._nworld)
        sources = {n: getattr(old, n) for n in self._constant} | self._before
        for name, source in sources.items():
            wp.copy(getattr(engine._data, name), source)
        self._prepare()
        self.refresh()

    def close(self) -> None:
        """Frees the device memory."""
        self._views, self._before = {}, {}
        self._engine.close()

    def _prepare(self) -> None:
        """What belongs to the arrays that there are now."""
        self.generation += 1
        self._views = {}
        data = self._engine._data
        with self._engine._scope():
            arrays = {name: getattr(data, name) for name in self._changed}
            self._before = {n: wp.clone(a) for n, a in arrays.items() if a.size}
            self._sensors = wp.zeros_like(data.sensordata)
            self._columns = wp.array(self._accelerations, dtype=int)

    def _advance(self, nstep: int) -> None:
        engine, data = self._engine, self._engine._data
        engine._lost.fill_(-1)
        for name, kept in self._before.items():
            wp.copy(kept, getattr(data, name))
        for done in range(nstep):
            if self._in_two and done:
                self._stages()
            engine._timestep(advance=mjw.step2 if self._in_two else mjw.step)
        if self._accelerations.size:
            wp.copy(self._sensors, data.sensordata)
        self._stages()
        if self._accelerations.size:  # they belong to the last timestep
            shape = (self._nworld, self._accelerations.size)
            wp.launch(kernels.copy_columns, shape, [self._columns, self._sensors, data.sensordata])

    def _stages(self) -> None:
        if self._in_two:
            mjw.step1(self._engine._model, self._engine._data)
        else:
            self._engine._stages()


def _tensor(array: wp.array, device: Any) -> Any:
    """The memory of an array as a tensor; of one without elements, a new one."""
    if array.size:
        return wp.to_torch(array)
    import torch

    return torch.zeros(array.shape, device=device)


def _advances_in_two(model: mujoco.MjModel) -> bool:
    """Whether a timestep can begin with stages that were computed before."""
    sleeps = model.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    return model.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4 and not sleeps
