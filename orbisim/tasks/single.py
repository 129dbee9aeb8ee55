"""Tasks of one free body that nobody acts on."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbisim.scene import Scene
from orbisim.state import State
from orbisim.tasks.base import Scripted
from orbisim.tasks.episode import Rollout

Floats = npt.NDArray[np.float64]


def passive_rollout(time: Floats, qpos: Floats, qvel: Floats) -> Rollout:
    """A rollout without actuators."""
    steps = len(time) - 1
    none = np.zeros((steps, 0))
    return Rollout(time, qpos, qvel, np.zeros((steps + 1, 0)), none, none)


def passive_trials(
    scene: Scene, qpos: Floats, qvel: Floats, horizon: float, control_timestep: float
) -> Scripted:
    """Episodes [n] from initial states, without controls."""
    count = len(qpos)
    state = State(time=np.zeros(count), qpos=qpos, qvel=qvel, act=np.zeros((count, scene.model.na)))
    sequence = np.zeros((count, round(horizon / control_timestep), 0))
    return Scripted(scene, state, sequence, control_timestep)
