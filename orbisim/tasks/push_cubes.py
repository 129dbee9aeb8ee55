"""`task:push_cubes`: a UR5e pushes two to four cubes, then moves at random."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from orbisim.tasks.arm import UR5E
from orbisim.tasks.armtask import ArmTask
from orbisim.tasks.episode import Floats
from orbisim.tasks.motion import Move, Plan, wander
from orbisim.tasks.push import (
    HOVER,
    PushConfig,
    Stroke,
    behind,
    draw_hit,
    hit,
    inside,
    slide,
    start_of_tool,
    within,
)
from orbisim.tasks.staging import Script, Stage
from orbisim.tasks.tabletop import Pose, Setting, scatter, tower

_ABOVE = (np.array([0.32, -0.28, 0.12]), np.array([0.68, 0.28, 0.3]))
"""Box of the motion after the task, m."""
_ROOM = 0.02
"""Room behind a cube where the fingers go down, m."""


class PushCubes(ArmTask):
    """Paper appendix A.2: pushing at random, pushing stacks, towards an object, to hit it."""

    name: ClassVar[str] = "push_cubes"
    counts: ClassVar[Mapping[str, int]] = {
        "random": 420,
        "stacked": 420,
        "towards_object": 420,
        "to_hit": 420,
    }
    default_subtask = "random"
    arm = UR5E
    steps = 160
    config: PushConfig = PushConfig()

    def count_of_cubes(self, subtask: str, rng: np.random.Generator) -> int:
        """Three or four; two in the subtasks with an object to go for."""
        return int(rng.integers(3, 5)) if subtask in ("random", "stacked") else 2

    def script(self, subtask: str, setting: Setting, rng: np.random.Generator) -> Script:
        """Where everything stands and what the arm does."""
        tool = start_of_tool(rng)
        if subtask in ("random", "stacked"):
            poses = (
                self._stacks(setting, rng) if subtask == "stacked" else self._spread(setting, rng)
            )
            return Script(poses, tool, lambda stage: self._pushes(stage, setting, rng))
        poses, stroke = draw_hit(setting, self.config, rng)
        if subtask == "towards_object":
            stroke = _stop_short(stroke, poses, rng)
        return Script(poses, tool, lambda stage: _then_wander(stroke, rng))

    def success(self, subtask: str, setting: Setting, cubes: Floats) -> bool | None:
        """To hit, as in `push`; towards an object: the cubes end closer than they were."""
        if subtask == "to_hit":
            return hit(cubes)
        if subtask == "towards_object":
            gaps = np.linalg.norm(cubes[:, 0, :2] - cubes[:, 1, :2], axis=1)
            return bool(gaps[-1] < gaps[0] - 0.01)
        return None

    def _spread(self, setting: Setting, rng: np.random.Generator) -> list[Pose]:
        return scatter(setting, self.config, rng)

    def _stacks(self, setting: Setting, rng: np.random.Generator) -> list[Pose]:
        """A tower of at least two cubes, the others beside it."""
        return tower(setting, self.config, rng, int(rng.integers(2, len(setting.cubes) + 1)))

    def _pushes(self, stage: Stage, setting: Setting, rng: np.random.Generator) -> Plan:
        """Two pushes of cubes on the table in directions that have room, then random motion."""
        for _ in range(2):
            stroke = self._draw_stroke(stage, setting, rng)
            if stroke is None:
                break
            yield from stroke.segments()
            yield Move((*stroke.end, HOVER), speed=0.5)
        yield from wander(rng, *_ABOVE)

    def _draw_stroke(
        self, stage: Stage, setting: Setting, rng: np.random.Generator
    ) -> Stroke | None:
        """A push of a random cube on the table, whose approach no other cube is in the way of."""
        count = len(setting.cubes)
        spots = [stage.position(f"cube{i + 1}") for i in range(count)]
        low = [i for i in range(count) if 0 < spots[i][2] < 1.5 * setting.cubes[i].half]
        for _ in range(100 if low else 0):
            index = low[int(rng.integers(len(low)))]
            heading = rng.uniform(-np.pi, np.pi)
            direction = np.array([np.cos(heading), np.sin(heading)])
            distance, speed = rng.uniform(*self.config.distance), rng.uniform(*self.config.speed)
            x, y, z = spots[index]
            pose = Pose((float(x), float(y), float(z)), stage.yaw(f"cube{index + 1}"))
            start = behind(pose, setting.cubes[index].half, heading, _ROOM)
            stroke = Stroke(start, heading, _ROOM + distance, speed)
            others = [spots[i][:2] for i in range(count) if i != index]
            free = all(np.linalg.norm(np.array(start) - other) > 0.065 for other in others)
            end = spots[index][:2] + (distance + slide(speed)) * direction
            if free and within(start) and within(stroke.end) and inside(end):
                return stroke
        return None


def _stop_short(stroke: Stroke, poses: list[Pose], rng: np.random.Generator) -> Stroke:
    """The stroke ends about where the cubes meet, and is slow."""
    gap = np.linalg.norm(np.array(poses[0].pos[:2]) - np.array(poses[1].pos[:2]))
    reach = gap - poses[0].pos[2] - poses[1].pos[2] + _ROOM
    length = float(reach + rng.uniform(-0.02, 0.01))
    return Stroke(stroke.start, stroke.heading, max(length, 0.03), min(stroke.speed, 0.2))


def _then_wander(stroke: Stroke, rng: np.random.Generator) -> Plan:
    up = Move((*stroke.end, HOVER), speed=0.5)
    return itertools.chain(stroke.segments(), [up], wander(rng, *_ABOVE))
