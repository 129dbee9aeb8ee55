"""`task:push`: a UR5e pushes a cube so that it hits another."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from orbisim.tasks.arm import UR5E
from orbisim.tasks.armtask import ArmTask
from orbisim.tasks.motion import Hold, Move, nearest_turn, wander
from orbisim.tasks.sampling import Range
from orbisim.tasks.staging import Script
from orbisim.tasks.tabletop import SETTLED, Pose, Setting, TabletopConfig, on_table, scatter

Floats = npt.NDArray[np.float64]

FINGER_DEPTH = 0.011
"""Half the depth of the closed fingers along the push, m."""
HOVER, SKIM = 0.14, 0.026
"""Heights of the end effector above the table when it travels and when it pushes, m."""
SUCCESS_DISTANCE = 0.05
"""How far the second cube must move, m."""
LOW, HIGH = np.array([0.24, -0.32]), np.array([0.84, 0.32])
"""Where cubes should end, with a margin to the table's edge, m."""
WORKSPACE = (np.array([0.32, -0.28, 0.03]), np.array([0.68, 0.28, 0.26]))
"""Box of random motion, m."""


@dataclasses.dataclass(frozen=True)
class PushConfig(TabletopConfig):
    """What the task is drawn from, beside the scene.

    Attributes:
      speed: of the push, m/s. distance: of a push in a random direction, m.
      spacing: from cube to cube before a hit, between their faces, m.
      follow: how far the push goes on after the cubes meet, m.
      aim: standard deviation of the direction of the push, rad.
    """

    speed: Range = (0.1, 0.7)
    distance: Range = (0.06, 0.2)
    spacing: Range = (0.03, 0.1)
    follow: Range = (0.05, 0.13)
    aim: float = 0.06


@dataclasses.dataclass(frozen=True)
class Stroke:
    """One push: from `start` along `heading` for `length` m at `speed` m/s, heights as above."""

    start: tuple[float, float]
    heading: float
    length: float
    speed: float

    @property
    def end(self) -> tuple[float, float]:
        """Where the end effector stops, m."""
        direction = np.array([np.cos(self.heading), np.sin(self.heading)])
        x, y = np.array(self.start) + self.length * direction
        return float(x), float(y)

    def segments(self, skim: float = SKIM) -> Iterator[Move | Hold]:
        """Move behind the cube, go down, push."""
        yaw = nearest_turn(self.heading, np.pi)
        yield Move((*self.start, HOVER), yaw=yaw, speed=0.6, accel=4.0)
        yield Move((*self.start, skim), yaw=yaw, speed=0.35)
        yield Hold(2)
        yield Move((*self.end, skim), yaw=yaw, speed=self.speed, accel=8.0)


class Push(ArmTask):
    """Paper section 4.1, appendix A.1: random motion, pushing, pushing to hit."""

    name: ClassVar[str] = "push"
    counts: ClassVar[Mapping[str, int]] = {"random": 120, "push": 640, "to_hit": 1840, "three": 0}
    default_subtask = "to_hit"
    arm = UR5E
    steps = 110
    config: PushConfig = PushConfig()

    def count_of_cubes(self, subtask: str, rng: np.random.Generator) -> int:
        """Two; three in the held-out subtask `three`."""
        return 3 if subtask == "three" else 2

    def script(self, subtask: str, setting: Setting, rng: np.random.Generator) -> Script:
        """Where everything stands and what the arm does."""
        tool = start_of_tool(rng)
        if subtask == "random":
            return Script(
                scatter(setting, self.config, rng), tool, lambda stage: wander(rng, *WORKSPACE)
            )
        draw = draw_push if subtask == "push" else draw_hit
        poses, stroke = draw(setting, self.config, rng)
        return Script(poses, tool, lambda stage: stroke.segments())

    def success(self, subtask: str, setting: Setting, cubes: Floats) -> bool | None:
        """To hit: the second cube moves more than 5 cm and the first stays on the table."""
        return hit(cubes) if subtask in ("to_hit", "three") else None


def hit(cubes: Floats) -> bool:
    """Whether cube 2 moved more than 5 cm over the table and cube 1 is still on it."""
    moved = np.linalg.norm(cubes[-1, 1, :2] - cubes[0, 1, :2]) > SUCCESS_DISTANCE
    return bool(moved and on_table(cubes[-1, :2]).all())


def start_of_tool(rng: np.random.Generator) -> tuple[float, float, float]:
    """Where the end effector is at the start, m."""
    x, y, z = rng.uniform([0.35, -0.2, 0.12], [0.6, 0.2, 0.26])
    return float(x), float(y), float(z)


def behind(pose: Pose, half: float, heading: float, clearance: float) -> tuple[float, float]:
    """Where the fingers go down, `clearance` m behind a cube as seen along the heading."""
    turn = abs(nearest_turn(pose.yaw - heading, np.pi / 2))
    reach = half * (np.cos(turn) + np.sin(turn))
    back = reach + FINGER_DEPTH + clearance
    x, y = np.array(pose.pos[:2]) - back * np.array([np.cos(heading), np.sin(heading)])
    return float(x), float(y)


def draw_push(
    setting: Setting, config: PushConfig, rng: np.random.Generator
) -> tuple[list[Pose], Stroke]:
    """Cubes anywhere, and a push of the first one in a random direction."""
    half = setting.cubes[0].half
    while True:
        poses = scatter(setting, config, rng)
        heading = rng.uniform(-np.pi, np.pi)
        distance, speed = rng.uniform(*config.distance), rng.uniform(*config.speed)
        start = behind(poses[0], half, heading, 0.02)
        stroke = Stroke(start, heading, 0.02 + distance, speed)
        way = distance + slide(speed)
        end = np.array(poses[0].pos[:2]) + way * np.array([np.cos(heading), np.sin(heading)])
        others = [np.array(p.pos[:2]) for p in poses[1:]]
        free = all(np.linalg.norm(np.array(start) - other) > 0.07 for other in others)
        if free and within(start) and inside(end) and within(stroke.end):
            return poses, stroke


def draw_hit(
    setting: Setting, config: PushConfig, rng: np.random.Generator
) -> tuple[list[Pose], Stroke]:
    """A cube in front of another in a random direction, and a push that makes them meet."""
    first, second = setting.cubes[0].half, setting.cubes[1].half
    while True:
        heading, speed = rng.uniform(-np.pi, np.pi), rng.uniform(*config.speed)
        direction = np.array([np.cos(heading), np.sin(heading)])
        spacing, follow = rng.uniform(*config.spacing), rng.uniform(*config.follow)
        yaws = heading + rng.normal(0, 0.2), rng.uniform(-np.pi, np.pi)
        off = rng.normal(0, config.aim)
        spot = np.array([rng.uniform(*config.x), rng.uniform(*config.y)])
        target = spot + (first + second + spacing) * direction
        poses = [_at(spot, first, yaws[0]), _at(target, second, yaws[1])]
        aimed = heading + off
        start = behind(poses[0], first, aimed, 0.02)
        stroke = Stroke(start, aimed, 0.02 + spacing + follow, speed)
        end = target + (follow + slide(speed)) * direction
        if not (within(start) and within(stroke.end) and inside(end)):
            continue
        if len(setting.cubes) > 2:
            third = rng.uniform([config.x[0], config.y[0]], [config.x[1], config.y[1]])
            gaps = [np.linalg.norm(third - np.array(p)) for p in (spot, target, np.array(start))]
            if min(gaps) < 0.1:
                continue
            poses.append(_at(third, setting.cubes[2].half, rng.uniform(-np.pi, np.pi)))
        return poses, stroke


def _at(spot: Floats, half: float, yaw: float) -> Pose:
    return Pose((float(spot[0]), float(spot[1]), half - SETTLED), yaw)


def slide(speed: float) -> float:
    """How far a cube slides on the slipperiest table of the training range, and a margin, m."""
    return speed**2 / (2 * 0.2 * 9.81) + 0.03


def within(spot: tuple[float, float]) -> bool:
    """Whether the end effector reaches a spot near the table."""
    return bool(0.28 < np.hypot(*spot) < 0.74 and spot[0] > 0.24)


def inside(spot: Floats) -> bool:
    """Whether a cube may end there."""
    return bool((spot > LOW).all() and (spot < HIGH).all())
