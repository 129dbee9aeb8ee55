"""Worlds that another backend steps, mirrored into MuJoCo for what tasks read of them."""

from __future__ import annotations

from typing import Any

import mujoco
import mujoco.batch
import numpy as np
import numpy.typing as npt

from orbisim.backend import Backend
from orbisim.errors import DivergedError, InputError, UnsupportedSceneError
from orbisim.physics.mirror import ACCELERATION_FIELDS
from orbisim.physics.mjdata import acceleration_sensors
from orbisim.state import MEMORY, State
from orbisim.vector.models import ModelFields
from orbisim.vector.simulator import Ids, Rows, Threads

_PHYSICAL = ("time", "qpos", "qvel", "act")
_GIVEN = frozenset({*_PHYSICAL, *MEMORY, "ctrl"})
"""What is known of a state without a stage of MuJoCo's."""
_BODY_FORCES = frozenset({"cacc", "cfrc_ext", "cfrc_int"})
"""Reported only where they cost another pass over all bodies, and no task of the suite reads them:
left out."""


class Mirrored(Threads):
    """Steps by a backend; positions and velocities go through MuJoCo's stages of them.

    They do so in the backend where it derives what is asked for, otherwise, and if any world is to
    be seen alone, in C MuJoCo. As in `orbisim.Physics`, what depends on accelerations comes from
    the backend, and is NaN where the backend does not report it.

    Args:
      backend: with the model's scene loaded.
      model, fields, nworld: see `Threads`.
      exact: whether to go through C MuJoCo's stages in any case.
    """

    def __init__(
        self,
        backend: Backend,
        model: mujoco.MjModel,
        fields: ModelFields,
        nworld: int,
        *,
        exact: bool = False,
    ) -> None:
        super().__init__(model, fields, nworld)
        self.backend = backend
        self._derivable = frozenset() if exact else backend.derivable
        self._derived: dict[str, Rows] = {}
        self._asked: set[str] = set()
        self._stale = np.zeros(nworld, bool)
        backend.report = (backend.reportable & {*ACCELERATION_FIELDS, "sensordata"}) - _BODY_FORCES
        self._private: dict[str, Rows] = {}
        self._fresh = np.ones(nworld, bool)
        self._unknown = acceleration_sensors(model)
        self._reported: dict[str, Rows] = {}

    def set_world(self, world: int, data: mujoco.MjData) -> None:
        """Gives a world a state; what the backend remembered of it is forgotten."""
        super().set_world(world, data)
        self._fresh[world] = True

    def set_models(self, worlds: Ids) -> None:
        """See `Threads.set_models`.

        Raises:
          UnsupportedSceneError: something differs that enters the dynamics.
        """
        for name, rows in self._fields.varied.items():
            if not self._fields.harmless(name):
                raise UnsupportedSceneError(
                    self.backend.scene.source,
                    f"the task changes {name!r} from world to world ({rows.shape[1:]} numbers)",
                    remedy=f"backend {self.backend.name!r} simulates one model; use 'mujoco'",
                )
        super().set_models(worlds)

    def step(self, worlds: Ids, nstep: int) -> npt.NDArray[np.bool_]:
        """See `Threads.step`."""
        steps = self.backend_steps(nstep)
        lost = np.zeros(self.nworld, bool)
        for part in self._parts(worlds):
            self._step_part(part, steps, lost)
        self._stale[worlds[~lost[worlds]]] = True
        self._late.clear()
        self._derived.clear()
        return lost[worlds]

    def field(self, name: str) -> Rows:
        """See `Threads.field`; NaN where the backend does not say."""
        if name in ACCELERATION_FIELDS and name in mujoco.batch.DATA_FIELDS:
            return self._report_of(name)
        if name in _GIVEN:
            return super().field(name)
        if name in self._derivable and not self._fields.varied:
            rows = self._derivation_of(name)
        else:
            self._mirror()
            rows = super().field(name)
        if name != "sensordata" or not self._unknown.size:
            return rows
        rows = np.array(rows)
        rows[:, self._unknown] = self._report_of(name)[:, self._unknown]
        return rows

    def fill(self, world: int, data: mujoco.MjData) -> None:
        """See `Threads.fill`."""
        self._mirror()
        super().fill(world, data)
        for name in ACCELERATION_FIELDS:
            counted = name.startswith("efc_")  # as many as constraints: never the backend's
            getattr(data, name)[...] = np.nan if counted else self._report_of(name)[world]
        if self._unknown.size:
            data.sensordata[self._unknown] = self._report_of("sensordata")[world, self._unknown]

    @property
    def state(self) -> State:
        """The state of all worlds, with what the backend remembers."""
        state = super().state
        return state if self._fresh.any() else state.with_memory(**self._private)

    def take_over(self, state: State) -> None:
        """Goes on from a state that the backend has reached elsewhere."""
        self._take(np.arange(self.nworld), state)
        self._stale[:] = True
        self._late.clear()
        self._derived.clear()

    def _mirror(self) -> None:
        """C MuJoCo's own stages of positions and velocities, where they were not since a step."""
        worlds = np.flatnonzero(self._stale)
        if worlds.size:
            self._stale[:] = False
            self._batch.forward(worlds, mujoco.mjtStage.mjSTAGE_VEL)

    def _derivation_of(self, name: str) -> Rows:
        """What the backend derives; with it, all that was ever asked for."""
        if name not in self._derived:
            self._asked.add(name)
            found = self.backend.derive(super().state, self._asked)
            self._derived = {n: _on_host(rows) for n, rows in found.items()}
        return self._derived[name]

    def _report_of(self, name: str) -> Rows:
        if name not in self._reported:
            shape = getattr(self._data, name).shape
            self._reported[name] = np.full((self.nworld, *shape), np.nan)
        return self._reported[name]

    def _parts(self, worlds: Ids) -> list[Ids]:
        """Worlds to step together: what a backend remembers of some, it must not of those that
        begin."""
        if not self._private:
            return [worlds]
        fresh = self._fresh[worlds]
        return [worlds[fresh], worlds[~fresh]]

    def _step_part(self, worlds: Ids, steps: int, lost: npt.NDArray[np.bool_]) -> None:
        """Steps worlds that the backend remembers, or worlds that begin; notes those it loses.

        The backend always steps as many worlds as there are, so that it neither allocates nor
        records anew: one of `worlds` stands in the places of the others.
        """
        while worlds.size:
            places = np.full(self.nworld, worlds[0])
            places[worlds] = worlds
            try:
                after = self.backend.step(self._state(places), self.ctrl[places], steps)
            except DivergedError as error:
                if not error.worlds:
                    raise
                lost[places[list(error.worlds)]] = True
                worlds = worlds[~lost[worlds]]
                continue
            self._take(worlds, after.numpy()[worlds])
            return

    def _state(self, worlds: Ids) -> State:
        state = super().state[worlds]
        if not self._private or self._fresh[worlds[0]]:
            return state
        return state.with_memory(**{n: rows[worlds] for n, rows in self._private.items()})

    def _take(self, worlds: Ids, after: State) -> None:
        """Keeps what the backend returned for some worlds."""
        for name in _PHYSICAL:
            self._batch.bind(name)[worlds] = getattr(after, name)
        for name, rows in after.memory.items():
            if name in self.backend.report:
                known = self._report_of(name)
                known[worlds] = rows.reshape(len(worlds), *known.shape[1:])
            elif name in MEMORY:
                self._batch.bind(name)[worlds] = rows
            else:
                kept = self._private.get(name)
                if kept is None:
                    kept = self._private[name] = np.zeros((self.nworld, *rows.shape[1:]))
                kept[worlds] = rows
        self._fresh[worlds] = False

    def backend_steps(self, nstep: int) -> int:
        """How many steps of the backend `nstep` timesteps are.

        Raises:
          InputError: no whole number.
        """
        ratio = nstep * float(self.model.opt.timestep) / self.backend.timestep
        if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < 1:
            raise InputError(
                f"backend {self.backend.name!r} advances {self.backend.timestep:g} s at a time; "
                f"the task's control step, {nstep} timesteps of {self.model.opt.timestep:g} s, is "
                "not a multiple of it"
            )
        return round(ratio)


def _on_host(rows: Any) -> Rows:
    """An array, or a tensor on any device, in float64."""
    return np.asarray(rows.cpu() if hasattr(rows, "cpu") else rows, np.float64)
