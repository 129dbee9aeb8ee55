"""Whether the numbers of episodes mean something, before a network is trained on them."""

from __future__ import annotations

import torch
from torch import Tensor

from orbisim.errors import InputError
from orbisim_world_model.pack import Pack

MOST = 1e10
"""Size of a coordinate, velocity or control from which on MuJoCo takes a simulation to have
diverged (its mjMAXVAL). Squares of numbers much larger are infinite in float32."""

_RUNNING = ("qpos", "qvel", "act", "ctrl", "action", "base")


def check_numbers(pack: Pack, path: str) -> None:
    """Checks that every number of the episodes can be computed with.

    Raises:
      InputError: one is NaN, infinite, or so large that it is no measurement; the message names
        episode and step.
    """
    for name in _RUNNING:
        rows = _unusable(getattr(pack, name))
        if len(rows):
            episode, step = _place(pack, int(rows[0]))
            values = getattr(pack, name)[int(rows[0])]
            _refuse(path, f"episode {episode}, step {step}: {name}", values)
    for name in ("attributes", "world", "mask"):
        rows = _unusable(getattr(pack, name).flatten(1))
        if len(rows):
            _refuse(path, f"episode {int(rows[0])}: {name}", getattr(pack, name)[int(rows[0])])


def _unusable(values: Tensor) -> Tensor:
    return torch.nonzero(~(values.abs() < MOST).all(dim=1))[:1, 0]  # of NaN this is false


def _refuse(path: str, what: str, values: Tensor) -> None:
    value = float(values[~(values.abs() < MOST)].reshape(-1)[0])
    raise InputError(
        f"{path}: {what} holds {value:g}; expected finite numbers below {MOST:g}, as far as "
        "float32 goes; leave the episode out"
    )


def _place(pack: Pack, row: int) -> tuple[int, int]:
    """Episode and step of a row; -1 and the row itself for one that no episode has."""
    inside = (pack.start <= row) & (row <= pack.start + pack.length)
    found = torch.nonzero(inside)[:1, 0].tolist()
    return (found[0], row - int(pack.start[found[0]])) if found else (-1, row)
