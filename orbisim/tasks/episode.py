"""`Episode`: what one trial of a task leaves behind."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.errors import DivergedError

_UNSTABLE = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)

Floats = npt.NDArray[np.float64]


def clock(steps: int, control_timestep: float) -> Floats:
    """Times of `steps` control steps and their end [steps+1], s."""
    return np.arange(steps + 1, dtype=np.float64) * np.float64(control_timestep)


def check_stable(data: mujoco.MjData) -> None:
    """Raises `DivergedError` if MuJoCo met a state that it could not use and reset it.

    Args:
      data: of a simulation that ran from its reset.
    """
    if any(int(data.warning[kind].number) for kind in _UNSTABLE):
        raise DivergedError(f"the simulation became unstable before t = {data.time:g} s")


@dataclasses.dataclass(frozen=True, eq=False)
class Rollout:
    """A trial in the scene's own coordinates; T control steps.

    Attributes:
      time: [T+1], s. qpos: [T+1, nq]. qvel: [T+1, nv]. act: [T+1, na].
      ctrl: [T, nu], held during each control step.
      action: [T, A], what the task's policy commanded (7 for an arm: translation in m, rotation
        vector in rad, gripper from -1, open, to 1, closed; else the same as `ctrl`).
    """

    time: Floats
    qpos: Floats
    qvel: Floats
    act: Floats
    ctrl: Floats
    action: Floats


@dataclasses.dataclass(frozen=True, eq=False)
class Episode:
    """One trial as it is stored; see docs/episodes.md for the names.

    Attributes:
      subtask: which of the task's subtasks.
      seed: with the subtask (and the task's configuration), all that is needed to repeat it.
      scene_hash: fingerprint of the compiled scene.
      arrays: datasets by name.
      columns: names of the columns of descriptor datasets, by dataset.
      success: whether the task's measure of success holds; None where it has none.
    """

    subtask: str
    seed: int
    scene_hash: str
    arrays: Mapping[str, npt.NDArray[Any]]
    columns: Mapping[str, Sequence[str]]
    success: bool | None = None

    @property
    def steps(self) -> int:
        """Number of control steps T."""
        return len(self.arrays["time"]) - 1
