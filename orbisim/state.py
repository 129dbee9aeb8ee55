"""`State`: everything that a simulation needs to go on, as a value."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError
from orbisim.files import npz
from orbisim.files.reading import parse_json
from orbisim.files.writing import writing

SCHEMA = "orbisim.state/1"

Array: TypeAlias = Any
"""A NumPy array; a differentiable or on-device backend may use torch tensors instead."""

MEMORY = (
    "qacc_warmstart",
    "history",
    "plugin_state",
    "qfrc_applied",
    "xfrc_applied",
    "eq_active",
    "mocap_pos",
    "mocap_quat",
    "userdata",
)
"""Fields of MjData that a step of MuJoCo reads besides time, positions, velocities and controls."""

LARGEST = 1e10
"""Positions and velocities beyond this mean that a world has diverged (MuJoCo's `mjMAXVAL`)."""

_PHYSICAL = ("time", "qpos", "qvel", "act")


@dataclasses.dataclass(frozen=True, eq=False)
class State:
    """The state of `nworld` worlds. Never modified; a step returns a new one.

    Keeping a state is saving it, passing it is restoring it.

    Attributes:
      time: [nworld], s.
      qpos: [nworld, nq] generalized positions (rad, m, unit quaternions w x y z).
      qvel: [nworld, nv] generalized velocities (rad/s, m/s).
      act: [nworld, na] actuator activations.
      memory: what else the backend needs, by name, each [nworld, ...]. Names that are MjData's
        (`qacc_warmstart`, `mocap_pos`, `eq_active`, `history`, `qfrc_applied` ...) mean the same in
        every backend and are carried over when the backend is switched; a backend ignores other
        backends' private names and starts its own afresh.
    """

    time: Array
    qpos: Array
    qvel: Array
    act: Array
    memory: Mapping[str, Array] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, array in self._named():
            if not hasattr(array, "shape") or not array.shape:
                raise InputError(
                    f"State.{name} must be an array with a leading world axis; got {array!r}"
                )
            if array.shape[:1] != self.time.shape[:1]:
                raise InputError(
                    f"State.{name} has shape {tuple(array.shape)}; its leading axis must be the "
                    f"{self.time.shape[0]} worlds of State.time"
                )

    @property
    def nworld(self) -> int:
        """Number of worlds."""
        return int(self.time.shape[0])

    def _named(self) -> Iterator[tuple[str, Array]]:
        yield from ((name, getattr(self, name)) for name in _PHYSICAL)
        yield from self.memory.items()

    def replace(self, **changes: Any) -> State:
        """A copy with some fields replaced."""
        return dataclasses.replace(self, **changes)

    def with_memory(self, **changes: Array) -> State:
        """A copy with some memory entries replaced or added."""
        return self.replace(memory={**self.memory, **changes})

    def __getitem__(self, worlds: int | slice | Sequence[int] | npt.NDArray[Any]) -> State:
        """The chosen worlds, as a state; an integer keeps the world axis."""
        index = slice(worlds, worlds + 1 or None) if isinstance(worlds, int) else worlds
        return State(
            **{name: getattr(self, name)[index] for name in _PHYSICAL},
            memory={name: array[index] for name, array in self.memory.items()},
        )

    def tile(self, count: int) -> State:
        """`count` copies of every world: world i becomes worlds i*count to (i+1)*count - 1."""
        return self[np.repeat(np.arange(self.nworld), count)]

    @staticmethod
    def stack(states: Sequence[State]) -> State:
        """The worlds of several states after one another; memory entries they share are kept."""
        if not states:
            raise InputError("State.stack needs at least one state")
        shared = set(states[0].memory).intersection(*(s.memory for s in states))
        return State(
            **{name: _concatenate([getattr(s, name) for s in states]) for name in _PHYSICAL},
            memory={name: _concatenate([s.memory[name] for s in states]) for name in shared},
        )

    def numpy(self) -> State:
        """The same state with NumPy arrays (float64) on the host, detached from gradients."""
        return State(
            **{name: _to_numpy(getattr(self, name)) for name in _PHYSICAL},
            memory={name: _to_numpy(array) for name, array in self.memory.items()},
        )

    @property
    def finite(self) -> npt.NDArray[np.bool_]:
        """[nworld]: whether positions, velocities and activations are all finite."""
        arrays = [_to_numpy(getattr(self, name)) for name in ("qpos", "qvel", "act")]
        return np.asarray(np.stack([np.isfinite(a).all(axis=1) for a in arrays]).all(axis=0))

    @property
    def valid(self) -> npt.NDArray[np.bool_]:
        """[nworld]: whether a world can be stepped on: finite, and nothing beyond `LARGEST`."""
        arrays = [_to_numpy(getattr(self, name)) for name in ("qpos", "qvel")]
        sizes = np.stack([np.abs(a).max(axis=1, initial=0.0) for a in arrays])
        return self.finite & (sizes <= LARGEST).all(axis=0)

    def save(self, path: str | Path) -> None:
        """Writes the state to a `.npz` file.

        Raises:
          InputError: no file can be written there.
          OutputError: the disk is full.
        """
        host = self.numpy()
        arrays = dict(host._named())
        header = json.dumps({"schema": SCHEMA, "memory": sorted(host.memory)})
        with writing(path) as part, part.open("wb") as file:
            np.savez(file, **arrays, header=np.array(header))

    @staticmethod
    def load(path: str | Path) -> State:
        """Reads a state written by `save`.

        Raises:
          InputError: the file is not a saved state.
        """
        with npz.opened(path) as file:
            memory = _memory_names(path, file)
            if missing := sorted({*_PHYSICAL, *memory} - set(file)):
                raise InputError(f"{path}: not a saved state (it has no {missing[0]!r})")
            arrays = {name: file[name] for name in (*_PHYSICAL, *memory)}
        for name, array in arrays.items():
            _check_rows(path, name, array, None if name in memory else 1 + (name != "time"))
        return State(
            **{name: arrays[name] for name in _PHYSICAL},
            memory={name: arrays[name] for name in memory},
        )


def _memory_names(path: str | Path, file: npz.Npz) -> list[str]:
    """Names of the memory entries, by the header of a saved state."""
    text = file["header"] if "header" in file else np.array(0)
    header = parse_json(str(text), f"{path}, header") if text.dtype.kind == "U" else {}
    names = header.get("memory")
    known = isinstance(names, list) and all(isinstance(name, str) for name in names)
    if header.get("schema") != SCHEMA or not known:
        raise InputError(f"{path}: not a saved state (its header is not one of {SCHEMA})")
    return list(names or ())


def _check_rows(path: str | Path, name: str, array: npt.NDArray[Any], axes: int | None) -> None:
    """Raises `InputError` unless an array holds numbers and has so many axes (None: any)."""
    fits = array.ndim == axes if axes else array.ndim
    if array.dtype.kind not in "biuf" or not fits:
        raise InputError(
            f"{path}: {name!r} holds {array.dtype} of shape {array.shape}; expected numbers with "
            "a row for each world"
        )


def _concatenate(arrays: Sequence[Array]) -> Array:
    if isinstance(arrays[0], np.ndarray):
        return np.concatenate(arrays)
    import torch

    return torch.cat(list(arrays))


def _to_numpy(array: Array) -> npt.NDArray[Any]:
    if isinstance(array, np.ndarray):
        return array
    if hasattr(array, "detach"):
        array = array.detach().cpu()
    return np.asarray(array)
