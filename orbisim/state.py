"""`State`: everything that a simulation needs to go on, as a value."""

from __future__ import annotations

import dataclasses
import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError

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

    def save(self, path: str | Path) -> None:
        """Writes the state to a `.npz` file."""
        host = self.numpy()
        arrays = dict(host._named())
        header = json.dumps({"schema": "orbisim.state/1", "memory": sorted(host.memory)})
        with Path(path).open("wb") as file:
            np.savez(file, **arrays, header=np.array(header))

    @staticmethod
    def load(path: str | Path) -> State:
        """Reads a state written by `save`.

        Raises:
          InputError: the file is not a saved state.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                header = json.loads(str(file["header"]))
                if header.get("schema") != "orbisim.state/1":
                    raise ValueError(f"schema {header.get('schema')!r}")
                return State(
                    **{name: file[name] for name in _PHYSICAL},
                    memory={name: file[name] for name in header["memory"]},
                )
        except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
            raise InputError(f"{path}: not a saved state ({error})") from None


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
