"""States at the steps of a simulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.state import State
from orbisim.trajectory import Trajectory

Floats = npt.NDArray[np.float64]


class Nodes:
    """States at consecutive steps, with the last node of the piece before.

    Attributes:
      values: by name, [W, K, n] or None. first: step number of the first node, by name.
    """

    def __init__(self, piece: Trajectory, before: Nodes | None, done: int) -> None:
        self.values: dict[str, Floats | None] = {
            name: host(piece.with_initial(name)) for name in ("qpos", "qvel", "act")
        }
        self.first = dict.fromkeys(self.values, done)
        sensors = None if piece.sensordata is None else host(piece.sensordata)
        self.first["sensordata"] = done
        if sensors is not None and before is not None and before.values["sensordata"] is not None:
            sensors = np.concatenate([before.values["sensordata"][:, -1:], sensors], axis=1)
            self.first["sensordata"] = done - 1
        self.values["sensordata"] = sensors

    def only(self, keep: npt.NDArray[np.bool_]) -> Nodes:
        """The nodes of some worlds."""
        found = Nodes.__new__(Nodes)
        found.values = {n: None if v is None else v[keep] for n, v in self.values.items()}
        found.first = self.first
        return found


def join(initial_state: State, controls: Floats, pieces: Sequence[Trajectory]) -> Trajectory:
    """One trajectory from single steps; a world once lost stays lost."""
    lost = np.stack([piece.diverged_at >= 0 for piece in pieces])
    diverged_at = np.where(lost.any(axis=0), lost.argmax(axis=0), -1)
    sensors = [piece.sensordata for piece in pieces]
    return Trajectory(
        initial=initial_state,
        control=controls,
        sensordata=(
            np.concatenate([host(s) for s in sensors], axis=1)
            if all(s is not None for s in sensors)
            else None
        ),
        diverged_at=diverged_at,
        final=pieces[-1].final,
        **{
            name: np.concatenate([host(getattr(p, name)) for p in pieces], axis=1)
            for name in ("time", "qpos", "qvel", "act")
        },
    )


def host(array: Any) -> Floats:
    """A backend's array as NumPy float64 on the host."""
    return np.asarray(array.detach().cpu() if hasattr(array, "detach") else array, np.float64)
