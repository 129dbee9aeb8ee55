"""The worlds themselves: C MuJoCo on all cores, its position and velocity stages up to date."""

from __future__ import annotations

import copy
from typing import Any

import mujoco
import mujoco.batch
import numpy as np
import numpy.typing as npt

from orbisim.host.cpus import usable_cpus
from orbisim.state import MEMORY, State
from orbisim.vector.models import COSMETIC, ModelFields
from orbisim.vector.worlds import NotBatchedError

Rows = npt.NDArray[Any]
Ids = npt.NDArray[np.int64]

_SPEC = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_PHYSICAL = ("time", "qpos", "qvel", "act")


class Threads:
    """Every world as an MjData of its own, stepped by threads.

    A step ends as dm_control's: with `mj_step1`, so that what depends on positions and velocities
    belongs to the new state, and what depends on accelerations to the last substep.

    Args:
      model: of every world.
      fields: what differs between the worlds.
      nworld: number of worlds.
      legacy_step: whether `mj_step1` follows (dm_control's `Environment(legacy_step=...)`).
      nthread: number of threads; 0 for one per usable core.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        fields: ModelFields,
        nworld: int,
        *,
        legacy_step: bool = True,
        nthread: int = 0,
    ) -> None:
        self.model, self.nworld = model, nworld
        self._fields = fields
        threads = nthread or min(nworld, usable_cpus())
        self._batch = mujoco.batch.Batch(model, nworld, threads, persistent=True)
        self._stage = mujoco.mjtStage.mjSTAGE_VEL if legacy_step else mujoco.mjtStage.mjSTAGE_NONE
        self._data = mujoco.MjData(model)
        self._expanded: dict[str, Rows] = {}
        self._models: list[mujoco.MjModel] | None = None
        self._bound: set[str] = set()
        self._late: dict[str, Rows] = {}
        self.ctrl: Rows = self._batch.bind("ctrl")

    def set_world(self, world: int, data: mujoco.MjData) -> None:
        """Gives a world the state of an MjData."""
        mujoco.mj_getState(self.model, data, self._batch.state[world], _SPEC)

    def set_models(self, worlds: Ids) -> None:
        """Gives worlds the values that the fields of their models have now."""
        needed = [n for n in self._fields.varied if not any(part in n for part in COSMETIC)]
        if self._models is None and all(n in mujoco.batch.MODEL_FIELDS for n in needed):
            for name in needed:
                self._expand(name)[worlds] = self._fields.varied[name][worlds]
            return
        self._give_models(worlds)

    def step(self, worlds: Ids, nstep: int) -> npt.NDArray[np.bool_]:
        """Advances worlds by `nstep` timesteps; which of them MuJoCo warned of, [len(worlds)]."""
        batch = self._batch
        batch.warning[:] = 0
        self._late.clear()
        failed = np.zeros(self.nworld, bool)
        ids = None if len(worlds) == self.nworld else worlds
        try:
            batch.step(ids, nstep, self._stage)
        except mujoco.batch.SimulationError as error:
            failed[error.ids] = True
        failed |= np.asarray(batch.warning[:, :, 1] > 0).any(axis=1)
        return failed[worlds]

    def field(self, name: str) -> Rows:
        """A field of MjData in every world, [nworld, ...].

        Raises:
          NotBatchedError: MuJoCo has no such field for many worlds.
        """
        if name not in mujoco.batch.DATA_FIELDS:
            raise NotBatchedError(f"physics.data.{name}")
        if name not in self._bound:
            self._bound.add(name)
            self._late[name] = self._gathered(name)
        rows = self._late.get(name)
        return self._shaped(name, self._batch.bind(name) if rows is None else rows)

    def rows(self, name: str, worlds: Ids) -> Rows:
        """A part of the state of some worlds, [len(worlds), ...], a copy."""
        return np.asarray(self._batch.bind(name))[worlds]

    def fill(self, world: int, data: mujoco.MjData) -> None:
        """Copies a world's whole MjData."""
        self._batch.get_data(world, data)

    @property
    def physics(self) -> npt.NDArray[np.float64]:
        """[nworld, n] MuJoCo's own state of all worlds (mjSTATE_INTEGRATION), a copy."""
        return np.array(self._batch.state)

    @physics.setter
    def physics(self, rows: npt.NDArray[np.float64]) -> None:
        self._batch.state[:] = rows

    def close(self) -> None:
        """Frees the worlds and the threads."""
        del self._batch

    @property
    def state(self) -> State:
        """The state of all worlds."""
        named = {n: np.array(self._batch.bind(n)) for n in (*_PHYSICAL, *MEMORY)}
        physical = {n: named.pop(n) for n in _PHYSICAL}
        return State(**physical, memory={n: v for n, v in named.items() if v.size})

    def _gathered(self, name: str) -> Rows:
        """A field that was not copied out by the last call: read from every world."""
        bound: Rows = self._batch.bind(name)
        if bound.flags.writeable:  # a part of the state
            return bound
        rows = []
        for world in range(self.nworld):
            self.fill(world, self._data)
            rows.append(np.array(getattr(self._data, name)))
        return np.stack(rows)

    def _shaped(self, name: str, rows: Rows) -> Rows:
        """With the shape and type of MjData's own field."""
        one = np.asarray(getattr(self._data, name))
        shaped = rows.reshape(self.nworld, *one.shape)
        return shaped if shaped.dtype == one.dtype else shaped.astype(one.dtype)

    def _expand(self, name: str) -> Rows:
        if name not in self._expanded:
            self._expanded[name] = self._batch.expand(name)
        rows = self._expanded[name]
        return rows.reshape(self._fields.varied[name].shape)

    def _give_models(self, worlds: Ids) -> None:
        """A model for each world, where fields differ that a batch does not vary (terrains)."""
        if self._models is None:
            self._models = [copy.copy(self.model) for _ in range(self.nworld)]
            self._restart()
        for world in worlds:
            self._fields.write(int(world), self._models[world])
        self._batch.set_models(self._models)

    def _restart(self) -> None:
        """A batch without expanded fields, in the same state."""
        before = self._batch
        self._batch = mujoco.batch.Batch(self.model, self.nworld, before.nthread, persistent=True)
        self._batch.state[:] = before.state
        self.ctrl = self._batch.bind("ctrl")
        self._expanded.clear()
        self._bound.clear()
