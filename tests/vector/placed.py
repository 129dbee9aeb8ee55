"""C MuJoCo whose worlds stay in tensors between steps, as those of a backend on a GPU do."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import torch
from orbisim_mujoco import MujocoBackend

from orbisim.state import MEMORY

STATE = ("time", "qpos", "qvel", "act", "ctrl", *(n for n in MEMORY if n != "plugin_state"))
DERIVED = (
    "xpos",
    "xmat",
    "xipos",
    "geom_xpos",
    "site_xpos",
    "subtree_com",
    "cvel",
    "sensordata",
    "qacc",
)


class Place:
    """Worlds in place (see `orbisim.backend.InPlace`); numbers are float64, as they come.

    Attributes:
      too_small: steps that overflow before one fits.
    """

    device = torch.device("cpu")
    names = frozenset({*STATE, *DERIVED})

    def __init__(self, model: mujoco.MjModel, nworld: int) -> None:
        self.generation, self.too_small, self.closed = 1, 0, False
        self._model = model
        self._data = [mujoco.MjData(model) for _ in range(nworld)]
        self._fields: dict[str, Any] = {}
        self._move()

    def field(self, name: str) -> Any:
        return self._fields[name]

    @property
    def lost(self) -> Any:
        return self._lost

    @property
    def overflowed(self) -> Any:
        return self._overflowed

    def write(self, worlds: Any, rows: Any) -> None:
        for name, values in rows.items():
            field = self._fields[name]
            field[worlds] = values.reshape(len(worlds), *field.shape[1:]).to(field.dtype)

    def refresh(self) -> None:
        self._take()
        for data in self._data:
            mujoco.mj_step1(self._model, data)
        self._give()

    def step(self, nstep: int) -> None:
        self._before = {name: rows.clone() for name, rows in self._fields.items()}
        self._take()
        for world, data in enumerate(self._data):
            mujoco.mj_step(self._model, data, nstep)
            mujoco.mj_step1(self._model, data)
            self._lost[world] = bool(data.warning.number.any())
            data.warning.number[:] = 0
        self._give()
        self._overflowed.fill_(self.too_small > 0)
        if self.too_small:
            self._fields["qpos"].fill_(7.0)
            self.too_small -= 1

    def take_back(self) -> None:
        for name, rows in self._before.items():
            self._fields[name].copy_(rows)

    def repair(self) -> None:
        self.take_back()
        self.generation += 1
        self._move()

    def close(self) -> None:
        self.closed = True

    def _move(self) -> None:
        """Other memory."""
        count = len(self._data)
        for name in self.names:
            one = np.asarray(getattr(self._data[0], name))
            before = self._fields.get(name)
            fresh = torch.from_numpy(np.zeros((count, *one.shape), one.dtype))
            self._fields[name] = fresh if before is None else before.clone()
        self._lost = torch.zeros(count, dtype=torch.bool)
        self._overflowed = torch.zeros((), dtype=torch.bool)

    def _take(self) -> None:
        for world, data in enumerate(self._data):
            data.time = float(self._fields["time"][world])
            for name in STATE[1:]:
                getattr(data, name)[...] = self._fields[name][world].numpy()

    def _give(self) -> None:
        for name, rows in self._fields.items():
            stacked = np.stack([np.asarray(getattr(data, name)) for data in self._data])
            rows.copy_(torch.from_numpy(stacked))


class PlacedBackend(MujocoBackend):
    """C MuJoCo with worlds in place."""

    places: tuple[Place, ...] = ()

    def in_place(self, nworld: int) -> Any:
        place = Place(self.model, nworld)
        self.places = (*self.places, place)
        return place
