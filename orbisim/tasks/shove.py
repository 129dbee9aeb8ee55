"""`task:shove`: the scenes of `task:push` in motions that show what a cube weighs.

A stiff servo pushes a heavy cube as it pushes a light one. Two things tell them apart: a collision
with a cube whose mass is known, since momentum is kept, and a push or a lift by a known force,
which friction, mu m g, or weight holds back. The gripper of this task is a weak one: its force is
limited.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from orbisim.scene import Scene
from orbisim.tasks import assets
from orbisim.tasks.motion import CLOSED, OPEN, Hold, Move, Plan, nearest_turn
from orbisim.tasks.push import (
    HOVER,
    SKIM,
    Push,
    PushConfig,
    Stroke,
    behind,
    inside,
    slide,
    start_of_tool,
    within,
)
from orbisim.tasks.sampling import Range
from orbisim.tasks.staging import Script, Stage
from orbisim.tasks.tabletop import SETTLED, Pose, Setting, scatter

Floats = npt.NDArray[np.float64]

FINGER = 0.016
"""From the middle of the closed fingers to their outer faces, m."""
_FIRST_QPOS, _FIRST_QVEL = 8, 8
"""Coordinates of the first cube: six joints of the arm and two fingers come before."""
GRAVITY = 9.81
"""m/s^2."""
_ASIDE = 0.13
"""m, between the hand and a cube that it is not to touch while the fingers open."""
_MIDDLE = np.array([0.52, 0.0])
"""Of the part of the table that the arm reaches, m."""
_BEYOND = 0.02
"""m that cubes stay apart when the hand is to stop, before they meet."""


_GRASP, _RISING = 6, 1.0
"""Control steps in which a weak gripper closes about a cube, and the hand's speed at most, m/s."""


@dataclasses.dataclass(frozen=True)
class ShoveConfig(PushConfig):
    """What the task is drawn from, beside what `task:push` is.

    Attributes:
      steps: control steps of an episode.
      force: of the gripper's servo at most, N; it acts on each finger.
      arrival: speed at which a thrown cube meets the other one, m/s; it begins with what the table
        takes from it on the way. spin: about the vertical, rad/s, standard deviation.
      height: of a thrown cube above the table at the start, m; half of them slide from the start.
      gap: between the closed fingers and a cube that they are to flick, m.
      lift: acceleration of the hand as it rises, m/s^2.
    """

    steps: int = 24
    force: float = 1.0
    arrival: Range = (0.2, 0.8)
    spin: float = 1.0
    height: Range = (0.0, 0.015)
    gap: Range = (0.001, 0.004)
    lift: Range = (1.0, 8.0)


class Shove(Push):
    """Collisions of sliding cubes, and pushes by a weak gripper.

    Subtasks: `thrown` (cube 1 begins in motion, sliding or a little above the table, towards cube
    2; the arm stays out of the way), `flick` (the closed fingers stand beside cube 1 and open with
    limited force), `lifted` (the fingers close about cube 1 with that force and rise, so that a
    heavy one slips from them), `strikes` (strike after strike of cube 1 towards cube 2 by the stiff
    arm, which stops before they meet).
    """

    name: ClassVar[str] = "shove"
    asset = "push"
    counts: ClassVar[Mapping[str, int]] = {"thrown": 1200, "flick": 800, "lifted": 0, "strikes": 0}
    default_subtask = "thrown"
    config: ShoveConfig = ShoveConfig()

    @property
    def steps(self) -> int:  # type: ignore[override]
        """Control steps of an episode."""
        return self.config.steps

    def scene(self, subtask: str | None = None, seed: int | None = None) -> Scene:
        """A scene drawn from the distribution, with a gripper of limited force."""
        spec = super().scene(subtask, seed).spec
        spec.actuator("gripper").forcerange = [-self.config.force, self.config.force]
        return assets.scene(spec, self.label)

    def script(self, subtask: str, setting: Setting, rng: np.random.Generator) -> Script:
        """Where everything stands and what the arm does."""
        draw: Mapping[str, Callable[[Setting, ShoveConfig, np.random.Generator], Script]] = {
            "thrown": thrown,
            "flick": flick,
            "lifted": lifted,
            "strikes": strikes,
        }
        return draw[subtask](setting, self.config, rng)

    def success(self, subtask: str, setting: Setting, cubes: Floats) -> bool | None:
        """It has none."""
        return None


def thrown(setting: Setting, config: ShoveConfig, rng: np.random.Generator) -> Script:
    """Cube 1 begins in motion towards cube 2, with some spin; the arm stays above."""
    poses, velocity = throw(setting, config, rng)

    def plan(stage: Stage) -> Plan:
        stage.data.qvel[_FIRST_QVEL : _FIRST_QVEL + 6] = velocity
        return iter(())

    return Script(poses, start_of_tool(rng), plan)


def throw(
    setting: Setting, config: ShoveConfig, rng: np.random.Generator
) -> tuple[list[Pose], Floats]:
    """Poses of both cubes, and the velocity [6] of cube 1's free joint, m/s and rad/s."""
    first, second = setting.cubes[0].half, setting.cubes[1].half
    while True:
        heading, arrival = rng.uniform(-np.pi, np.pi), rng.uniform(*config.arrival)
        direction = np.array([np.cos(heading), np.sin(heading)])
        spot = np.array([rng.uniform(*config.x), rng.uniform(*config.y)])
        # faces may be turned, so that corners need room
        spacing = 0.41 * (first + second) + rng.uniform(*config.spacing)
        target = spot + (first + second + spacing) * direction
        if inside(target + slide(arrival) * direction):
            break
    speed = float(np.sqrt(arrival**2 + 2 * setting.table_friction * GRAVITY * spacing))
    high = rng.uniform(*config.height) if rng.random() < 0.5 else 0.0
    yaws = rng.uniform(-np.pi, np.pi, 2)
    aimed, spin = heading + rng.normal(0, config.aim), rng.normal(0, config.spin)
    poses = [_pose(spot, first, yaws[0], float(high)), _pose(target, second, yaws[1])]
    return poses, np.array([speed * np.cos(aimed), speed * np.sin(aimed), 0.0, 0.0, 0.0, spin])


def flick(setting: Setting, config: ShoveConfig, rng: np.random.Generator) -> Script:
    """The closed fingers stand beside cube 1 and open; cube 2 stands aside."""
    first, second = setting.cubes[0].half, setting.cubes[1].half
    while True:
        heading = rng.uniform(-np.pi, np.pi)
        direction = np.array([np.cos(heading), np.sin(heading)])
        spot = np.array([rng.uniform(*config.x), rng.uniform(*config.y)])
        turn = rng.normal(0, 0.1)
        reach = first * (np.cos(turn) + abs(np.sin(turn))) + FINGER + rng.uniform(*config.gap)
        hand = spot - reach * direction
        aside = np.array([rng.uniform(*config.x), rng.uniform(*config.y)])
        clear = min(float(np.linalg.norm(aside - p)) for p in (hand, spot))
        if clear > _ASIDE and within((float(hand[0]), float(hand[1]))) and inside(spot):
            break
    poses = [_pose(spot, first, heading + turn), _pose(aside, second, rng.uniform(-np.pi, np.pi))]
    # fingers open along the tool's y axis; which of the two pushes does not matter
    yaw = nearest_turn(heading + np.pi / 2, np.pi)
    tool = (float(hand[0]), float(hand[1]), SKIM)
    wait = int(rng.integers(1, 4))

    def plan(stage: Stage) -> Plan:
        yield Hold(wait, grip=CLOSED)
        yield Hold(1, grip=OPEN)

    return Script(poses, tool, plan, yaw=yaw)


def lifted(setting: Setting, config: ShoveConfig, rng: np.random.Generator) -> Script:
    """The open fingers stand about cube 1, close and rise; cube 2 stands aside."""
    first, second = setting.cubes[0].half, setting.cubes[1].half
    while True:
        spot = np.array([rng.uniform(*config.x), rng.uniform(*config.y)])
        aside = np.array([rng.uniform(*config.x), rng.uniform(*config.y)])
        clear = float(np.linalg.norm(aside - spot)) > _ASIDE
        if clear and within((float(spot[0]), float(spot[1]))):
            break
    yaw = float(rng.uniform(-np.pi / 2, np.pi / 2))
    poses = [_pose(spot, first, yaw), _pose(aside, second, rng.uniform(-np.pi, np.pi))]
    x, y = (float(v) for v in spot)
    rise = Move((x, y, HOVER), speed=_RISING, accel=float(rng.uniform(*config.lift)))

    def plan(stage: Stage) -> Plan:
        yield Hold(_GRASP, grip=CLOSED)
        yield rise

    return Script(poses, (x, y, SKIM), plan, yaw=yaw, grip=OPEN)


def strikes(setting: Setting, config: ShoveConfig, rng: np.random.Generator) -> Script:
    """Strike after strike of cube 1 towards cube 2; the hand stops before the cubes meet."""
    poses = scatter(setting, config, rng, gap=0.08)
    halves = [cube.half for cube in setting.cubes[:2]]

    def plan(stage: Stage) -> Plan:
        while True:
            stroke = _strike(stage, halves, config, rng)
            if stroke is None:
                yield Hold(1)  # another draw, a control step later
                continue
            yield from stroke.segments()
            yield Move((*stroke.end, HOVER), speed=0.6, accel=4.0)
            yield Hold(int(rng.integers(0, 5)))

    return Script(poses, start_of_tool(rng), plan)


def _strike(
    stage: Stage, halves: list[float], config: ShoveConfig, rng: np.random.Generator
) -> Stroke | None:
    """A stroke of cube 1 that lets go of it before cube 2; of one back to the middle, else."""
    spots = [stage.position(f"cube{i}")[:2] for i in (1, 2)]
    way = spots[1] - spots[0]
    free = float(np.linalg.norm(way)) - 1.41 * sum(halves) - _BEYOND
    number, heading = 0, float(np.arctan2(way[1], way[0]) + rng.normal(0, config.aim))
    length = min(free, float(rng.uniform(*config.distance)))
    if free < 0.03:  # too near for a run: one of them goes to the middle
        number = int(rng.integers(2))
        home = _MIDDLE - spots[number]
        heading = float(np.arctan2(home[1], home[0]) + rng.normal(0, 0.9))
        length = float(rng.uniform(*config.distance))
    spot, half = spots[number], halves[number]
    pose = Pose((float(spot[0]), float(spot[1]), half), stage.yaw(f"cube{number + 1}"))
    start, speed = behind(pose, half, heading, 0.02), float(rng.uniform(*config.speed))
    stroke = Stroke(start, heading, 0.02 + length, speed)
    end = spot + (length + slide(speed)) * np.array([np.cos(heading), np.sin(heading)])
    other = spots[1 - number]
    clear = np.linalg.norm(np.array(start) - other) > 0.07
    ok = clear and within(start) and within(stroke.end) and inside(end)
    return stroke if ok and stage.position(f"cube{number + 1}")[2] > 0 else None


def _pose(spot: Floats, half: float, yaw: float, high: float = 0.0) -> Pose:
    return Pose((float(spot[0]), float(spot[1]), half - SETTLED + high), float(yaw))
