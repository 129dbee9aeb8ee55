"""`Trajectory`: what a rollout returns, and how it is stored."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError
from orbisim.files import npz
from orbisim.files.reading import parse_json
from orbisim.files.writing import writing
from orbisim.state import Array, State

_SCHEMA = "orbisim.trajectory/1"
_PHYSICAL = ("time", "qpos", "qvel", "act")
_AXES: dict[str, tuple[str, ...]] = {
    "time": ("world", "step"),
    **{name: ("world", "step", name) for name in ("qpos", "qvel", "act", "control")},
    "initial_time": ("world",),
    **{f"initial_{name}": ("world", name) for name in ("qpos", "qvel", "act")},
    "diverged_at": ("world",),
}
"""Axes of the arrays in a file; those of one name have one size."""


@dataclasses.dataclass(frozen=True, eq=False)
class Trajectory:
    """States after each step of a rollout.

    Attributes:
      initial: the state that the rollout started from.
      control: [nworld, T, nu], held during each step.
      time: [nworld, T], s, after each step. qpos: [nworld, T, nq]. qvel: [nworld, T, nv].
      act: [nworld, T, na].
      sensordata: [nworld, T, nsensordata] or None. As MuJoCo does it, the sensors of a step are
        computed at the state where the step's last substep began.
      diverged_at: [nworld] first step whose result is not usable, -1 for none. From there on the
        world's rows are NaN.
      final: the state after the last step, with the backend's memory.
    """

    initial: State
    control: Array
    time: Array
    qpos: Array
    qvel: Array
    act: Array
    sensordata: Array | None
    diverged_at: npt.NDArray[np.int64]
    final: State

    @property
    def nworld(self) -> int:
        """Number of worlds."""
        return int(self.qpos.shape[0])

    @property
    def nstep(self) -> int:
        """Number of steps T."""
        return int(self.qpos.shape[1])

    def with_initial(self, name: str) -> Array:
        """`time`, `qpos`, `qvel` or `act` with the initial state in front: [nworld, T+1, ...]."""
        first, rest = getattr(self.initial, name)[:, None], getattr(self, name)
        if isinstance(rest, np.ndarray):
            return np.concatenate([first, rest], axis=1)
        import torch

        return torch.cat([torch.as_tensor(first), rest], dim=1)

    def state_at(self, step: int) -> State:
        """The physical state after step number `step` (from 0), without memory."""
        return State(
            **{name: getattr(self, name)[:, step] for name in ("time", "qpos", "qvel", "act")}
        )

    def save(self, path: str | Path, **notes: Any) -> None:
        """Writes the trajectory to a `.npz` file with `notes` (JSON values) in its header."""
        initial = self.initial.numpy()
        arrays = {
            f"initial_{name}": getattr(initial, name) for name in ("time", "qpos", "qvel", "act")
        }
        for name in ("control", "time", "qpos", "qvel", "act", "diverged_at"):
            value = getattr(self, name)
            arrays[name] = value.detach().cpu().numpy() if hasattr(value, "detach") else value
        if self.sensordata is not None:
            arrays["sensordata"] = np.asarray(self.sensordata)
        header = json.dumps({"schema": _SCHEMA, **notes})
        with writing(path) as part, part.open("wb") as file:
            np.savez_compressed(file, **arrays, header=np.array(header))

    @staticmethod
    def load(path: str | Path) -> tuple[Trajectory, dict[str, Any]]:
        """Reads a trajectory written by `save` and its notes.

        Raises:
          InputError: the file is not a saved trajectory.
        """
        with npz.opened(path) as file:
            notes = _notes(path, file)
            if missing := sorted(_AXES.keys() - set(file)):
                raise InputError(f"{path}: not a saved trajectory (it has no {missing[0]!r})")
            wanted = [*_AXES, *(["sensordata"] if "sensordata" in file else [])]
            arrays: dict[str, Any] = {name: file[name] for name in wanted}
        _check_shapes(path, arrays)
        initial = State(**{name: arrays.pop(f"initial_{name}") for name in _PHYSICAL})
        last = {name: arrays[name][:, -1] for name in _PHYSICAL} if arrays["time"].size else {}
        sensordata = arrays.pop("sensordata", None)
        final = initial.replace(**last)
        return Trajectory(initial=initial, **arrays, sensordata=sensordata, final=final), notes


def _notes(path: str | Path, file: npz.Npz) -> dict[str, Any]:
    """The notes in the header of a saved trajectory."""
    text = file["header"] if "header" in file else np.array(0)
    notes = parse_json(str(text), f"{path}, header") if text.dtype.kind == "U" else {}
    if notes.pop("schema", None) != _SCHEMA:
        raise InputError(f"{path}: not a saved trajectory (its header is not one of {_SCHEMA})")
    return notes


def _check_shapes(path: str | Path, arrays: dict[str, Any]) -> None:
    """Raises `InputError` unless the arrays are numbers with the axes of `Trajectory`."""
    sizes: dict[str, int] = {}
    for name, array in arrays.items():
        axes = _AXES.get(name, ("world", "step", name))
        whole = name == "diverged_at"
        if array.dtype.kind not in ("iu" if whole else "iuf") or array.ndim != len(axes):
            raise InputError(
                f"{path}: {name!r} holds {array.dtype} of shape {array.shape}; expected "
                f"{'whole ' if whole else ''}numbers with {len(axes)} axes"
            )
        for axis, size in zip(axes, array.shape, strict=True):
            if sizes.setdefault(axis, size) != size or (axis == "world" and not size):
                raise InputError(
                    f"{path}: {name!r} has shape {array.shape}; its {axis} axis does not fit the "
                    f"other arrays ({sizes[axis]})"
                )
