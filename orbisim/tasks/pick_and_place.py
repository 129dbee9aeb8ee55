"""`task:pick_and_place`: a Panda picks three or four cubes and puts them elsewhere."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from orbisim.tasks.arm import PANDA
from orbisim.tasks.armtask import ArmTask
from orbisim.tasks.episode import Floats
from orbisim.tasks.motion import CLOSED, OPEN, Hold, Move, Plan, nearest_turn, wander
from orbisim.tasks.sampling import Range
from orbisim.tasks.staging import Script, Stage
from orbisim.tasks.tabletop import Setting, TabletopConfig, on_table, scatter, tower

_ABOVE = (np.array([0.36, -0.26, 0.2]), np.array([0.62, 0.26, 0.4]))
_CLEAR = 0.08
"""Height above what it passes at which the arm travels, m."""
_DEEP = 0.012
"""Lowest height of the end effector above the table, m."""


@dataclasses.dataclass(frozen=True)
class PickConfig(TabletopConfig):
    """What the task is drawn from, beside the scene.

    Attributes:
      cube_half: half side of a cube, m. density: kg/m^3.
      speed: of the arm, m/s.
      drop: height of release above where a cube rests, m; stacks use a quarter of it.
      detour: how far the way from pick to place goes off the straight line, m.
    """

    cube_half: Range = (0.02, 0.028)
    density: Range = (150.0, 900.0)
    x: Range = (0.4, 0.6)
    y: Range = (-0.22, 0.22)
    speed: Range = (0.4, 0.8)
    drop: Range = (0.002, 0.06)
    detour: Range = (0.0, 0.08)


class PickAndPlace(ArmTask):
    """Paper appendix A.2: stacking, unstacking, and moving scattered cubes."""

    name: ClassVar[str] = "pick_and_place"
    counts: ClassVar[Mapping[str, int]] = {"stack": 420, "unstack": 420, "scattered": 420}
    default_subtask = "stack"
    arm = PANDA
    steps = 260
    config: PickConfig = PickConfig()

    def count_of_cubes(self, subtask: str, rng: np.random.Generator) -> int:
        """Three or four."""
        return int(rng.integers(3, 5))

    def script(self, subtask: str, setting: Setting, rng: np.random.Generator) -> Script:
        """Where everything stands and what the arm does."""
        x, y, z = rng.uniform([0.4, -0.15, 0.28], [0.55, 0.15, 0.38])
        plans = {"stack": self._stack, "unstack": self._unstack, "scattered": self._scattered}
        if subtask == "unstack":
            poses = tower(setting, self.config, rng, len(setting.cubes))
        else:
            poses = scatter(setting, self.config, rng, gap=0.045)
        tool = (float(x), float(y), float(z))
        return Script(poses, tool, lambda stage: plans[subtask](stage, setting, rng), grip=OPEN)

    def success(self, subtask: str, setting: Setting, cubes: Floats) -> bool | None:
        """Stack: one tower of all cubes; unstack: all on the table itself, apart.

        Scattered: all cubes on the table and one of them, at least, 5 cm from where it was.
        """
        halves = np.array([cube.half for cube in setting.cubes])
        end = cubes[-1]
        if subtask == "stack":
            order = np.argsort(end[:, 2])
            near = np.linalg.norm(np.diff(end[order, :2], axis=0), axis=1) < halves[order][1:]
            rests = np.abs(end[order, 2] - np.cumsum(2 * halves[order]) + halves[order]) < 0.005
            return bool(near.all() and rests.all())
        flat = bool((np.abs(end[:, 2] - halves) < 0.005).all() and on_table(end).all())
        if subtask == "unstack":
            return flat
        moved = np.linalg.norm(end[:, :2] - cubes[0, :, :2], axis=1) > 0.05
        return bool(on_table(end).all() and moved.any())

    def _stack(self, stage: Stage, setting: Setting, rng: np.random.Generator) -> Plan:
        """All other cubes, in random order, on top of a first one."""
        first, *others = (int(i) for i in rng.permutation(len(setting.cubes)))
        top = 2 * setting.cubes[first].half
        yaw = stage.yaw(f"cube{first + 1}")
        for index in others:
            x, y, _ = stage.position(f"cube{first + 1}")
            drop = rng.uniform(*self.config.drop) / 4
            goal = np.array([x, y, top + setting.cubes[index].half + drop])
            yield from self._carry(stage, setting, rng, index, goal, yaw)
            top += 2 * setting.cubes[index].half
        yield from wander(rng, *_ABOVE)

    def _unstack(self, stage: Stage, setting: Setting, rng: np.random.Generator) -> Plan:
        """From the top of the tower down, to free places on the table."""
        for index in range(len(setting.cubes) - 1, 0, -1):
            yield from self._carry_to_free_place(stage, setting, rng, index)
        yield from wander(rng, *_ABOVE)

    def _scattered(self, stage: Stage, setting: Setting, rng: np.random.Generator) -> Plan:
        """Cubes in random order to free places on the table."""
        for index in (int(i) for i in rng.permutation(len(setting.cubes))):
            yield from self._carry_to_free_place(stage, setting, rng, index)
        yield from wander(rng, *_ABOVE)

    def _carry_to_free_place(
        self, stage: Stage, setting: Setting, rng: np.random.Generator, index: int
    ) -> Plan:
        others = [stage.position(f"cube{i + 1}") for i in range(len(setting.cubes)) if i != index]
        spot = rng.uniform(*np.transpose([self.config.x, self.config.y]))
        for _ in range(200):
            if all(np.linalg.norm(spot - other[:2]) > 0.115 for other in others):
                break
            spot = rng.uniform(*np.transpose([self.config.x, self.config.y]))
        height = setting.cubes[index].half + rng.uniform(*self.config.drop)
        yaw = rng.uniform(-0.7, 0.7)
        yield from self._carry(stage, setting, rng, index, np.array([*spot, height]), yaw)

    def _carry(
        self,
        stage: Stage,
        setting: Setting,
        rng: np.random.Generator,
        index: int,
        goal: Floats,
        yaw: float,
    ) -> Plan:
        """Picks a cube and lets it go with its centre at `goal`, turned by `yaw`."""
        speed = float(rng.uniform(*self.config.speed))
        x, y, z = (float(v) for v in stage.position(f"cube{index + 1}"))
        if z < 0:
            return  # it fell off the table
        turn = nearest_turn(stage.yaw(f"cube{index + 1}"), np.pi / 2)
        tops = [stage.position(f"cube{i + 1}")[2] for i in range(len(setting.cubes))]
        travel = max(0.16, max(tops) + 0.03 + _CLEAR, float(goal[2]) + _CLEAR)
        low = max(z, _DEEP)
        yield Move((x, y, travel), yaw=turn, speed=speed, grip=OPEN)
        yield Move((x, y, low), speed=0.4)
        yield Hold(3)
        yield Hold(5, grip=CLOSED)
        yield Move((x, y, travel), speed=0.5, accel=2.0)
        gx, gy, gz = (float(v) for v in goal)
        middle = (np.array([x, y]) + goal[:2]) / 2 + _sideways(rng, self.config.detour)
        via = (float(middle[0]), float(middle[1]), travel)
        there = nearest_turn(yaw, np.pi / 2)
        yield Move(via, yaw=there, speed=speed, accel=2.0, near=0.03)
        yield Move((gx, gy, travel), yaw=there, speed=speed, accel=2.0)
        yield Move((gx, gy, gz + low - z), speed=0.25, accel=1.5)
        yield Hold(4)
        yield Hold(4, grip=OPEN)
        yield Move((gx, gy, travel), speed=0.5)


def _sideways(rng: np.random.Generator, size: Range) -> Floats:
    angle = rng.uniform(-np.pi, np.pi)
    return np.asarray(rng.uniform(*size) * np.array([np.cos(angle), np.sin(angle)]))
