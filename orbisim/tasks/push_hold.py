"""`task:push_hold`: the scenes of `task:push` over time: rest, holding, recovery, longer motion.

What a learned step needs beside pushes so that it holds: states in which nothing moves, states a
little or far off the ones that a policy visits, which go back, and motion without a script's end.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping
from typing import ClassVar

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.tasks.motion import Hold, Move, Plan, wander
from orbisim.tasks.push import (
    HOVER,
    WORKSPACE,
    Push,
    PushConfig,
    Stroke,
    behind,
    inside,
    slide,
    within,
)
from orbisim.tasks.staging import Script, Stage
from orbisim.tasks.tabletop import Pose, Setting, scatter

Floats = npt.NDArray[np.float64]

ROOM = (np.array([0.28, -0.32, 0.02]), np.array([0.75, 0.32, 0.45]))
"""Box of motion that is not a push, m; the start pose of the asset lies in it."""
_ARM, _FINGERS, _CUBES = 6, slice(6, 8), 8
"""Joints of the arm, then two fingers, then free bodies."""
_FINGER_RANGE = 0.0425
"""m, of each finger's joint."""
_KICK = np.tile([0.2, 0.2, 0.1, 1.0, 1.0, 1.0], 2)
"""Scale of the velocities of two cubes, m/s and rad/s."""
_MIDDLE = np.array([0.52, 0.0])
"""Of the part of the table that the arm reaches, m."""


@dataclasses.dataclass(frozen=True)
class PushHoldConfig(PushConfig):
    """What the task is drawn from, beside what `task:push` is.

    Attributes:
      steps: control steps of an episode.
    """

    steps: int = 110


class PushHold(Push):
    """Episodes of any length on the scenes of `task:push`.

    Subtasks: `rest` (nothing moves), `hold` (random motion that ends), `shaken` (starts off
    balance, by a millionth or by centimetres, and holds or moves on), `roam` (random motion
    through the whole room, among the cubes too), `strokes` (push after push of any cube).
    """

    name: ClassVar[str] = "push_hold"
    asset = "push"
    counts: ClassVar[Mapping[str, int]] = {
        "rest": 200,
        "hold": 600,
        "shaken": 1000,
        "roam": 500,
        "strokes": 700,
    }
    default_subtask = "hold"
    config: PushHoldConfig = PushHoldConfig()

    @property
    def steps(self) -> int:  # type: ignore[override]
        """Control steps of an episode."""
        return self.config.steps

    def script(self, subtask: str, setting: Setting, rng: np.random.Generator) -> Script:
        """Where everything stands and what the arm does."""
        x, y, z = (float(value) for value in rng.uniform(ROOM[0] + [0.02, 0.05, 0.1], ROOM[1]))
        poses, yaw = scatter(setting, self.config, rng), float(rng.uniform(-1.2, 1.2))
        script = Script(poses, (x, y, z), lambda stage: iter(()), yaw=yaw)
        if subtask == "rest":
            return script
        plans: Mapping[str, Callable[[Stage], Plan]] = {
            "hold": lambda stage: itertools.islice(
                wander(rng, *WORKSPACE), int(rng.integers(1, 4))
            ),
            "shaken": lambda stage: shaken(stage, rng),
            "roam": lambda stage: wander(rng, *ROOM, speed=(0.05, 0.8)),
            "strokes": lambda stage: strokes(stage, setting, self.config, rng),
        }
        return dataclasses.replace(script, plan=plans[subtask])


def shaken(stage: Stage, rng: np.random.Generator) -> Plan:
    """Puts the simulation off balance, then holds or moves.

    Joints, cubes and their velocities are moved by up to some centimetres, degrees, m/s and rad/s,
    all times one factor between a thousandth and one: small deviations decay as well.
    """
    data, size = stage.data, float(10 ** rng.uniform(-3, 0))
    data.qpos[:_ARM] += size * rng.normal(0, 0.03, _ARM)
    data.qvel[:_ARM] += size * rng.normal(0, 0.4, _ARM)
    fingers = data.qpos[_FINGERS] + size * rng.normal(0, 0.004, 2)
    data.qpos[_FINGERS] = np.clip(fingers, 0.0, _FINGER_RANGE)
    data.qvel[_FINGERS] += size * rng.normal(0, 0.03, 2)
    for first in range(_CUBES, stage.model.nq, 7):
        turn = size * rng.normal(0, 0.1, 3)
        data.qpos[first + 2] += size * abs(rng.normal(0, 0.01)) + 0.02 * float(np.abs(turn).sum())
        mujoco.mju_quatIntegrate(data.qpos[first + 3 : first + 7], turn, 1.0)
    data.qvel[_CUBES:] += size * rng.normal(0, 1.0, stage.model.nv - _CUBES) * _KICK
    return wander(rng, *WORKSPACE) if rng.random() < 0.3 else iter(())


def strokes(stage: Stage, setting: Setting, config: PushConfig, rng: np.random.Generator) -> Plan:
    """Push after push, each of a cube drawn at random, roughly towards the middle of the table."""
    while True:
        number = int(rng.integers(len(setting.cubes)))
        spot, half = stage.position(f"cube{number + 1}"), setting.cubes[number].half
        towards = float(np.arctan2(*(_MIDDLE - spot[:2])[::-1]))
        heading = towards + float(rng.normal(0, 0.9))
        distance, speed = float(rng.uniform(*config.distance)), float(rng.uniform(*config.speed))
        pose = Pose((float(spot[0]), float(spot[1]), half), stage.yaw(f"cube{number + 1}"))
        start = behind(pose, half, heading, 0.02)
        stroke = Stroke(start, heading, 0.02 + distance, speed)
        end = spot[:2] + (distance + slide(speed)) * np.array([np.cos(heading), np.sin(heading)])
        if not (within(start) and within(stroke.end) and inside(end) and spot[2] > 0):
            yield Hold(1)  # another draw, a control step later
            continue
        yield from stroke.segments()
        yield Move((*stroke.end, HOVER), speed=0.6, accel=4.0)
        yield Hold(int(rng.integers(0, 15)))
