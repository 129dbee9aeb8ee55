"""`task:stack`: a Panda puts three cubes on top of one another."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from orbisim.tasks.adapting import Frame, Piece, bridge, commanded
from orbisim.tasks.arm import ArmController, pointing_down
from orbisim.tasks.episode import Floats, Rollout
from orbisim.tasks.motion import OPEN, Hold, Plan
from orbisim.tasks.pick_and_place import PickAndPlace, PickConfig
from orbisim.tasks.sampling import Range, stream
from orbisim.tasks.staging import Script, Stage, perform
from orbisim.tasks.tabletop import Setting, scatter

DEMONSTRATIONS = 10
"""That other episodes are adapted from."""
_STILL = 10
"""Control steps at the end in which no cube may move."""
_HIGH = 0.15
"""Height of the tool at which a piece of a demonstration ends: free to go elsewhere, m."""
_TOOL = (0.45, 0.0, 0.32)
"""Where the tool begins, m."""


@dataclasses.dataclass(frozen=True)
class StackConfig(PickConfig):
    """What the task is drawn from, beside the scene.

    Attributes:
      cube_half: half side of a cube, m; one size, so that a demonstration fits.
      drop: height of release above where a cube rests, m.
      noise: of adapted episodes: largest distance by which a piece is off, along each axis, m.
    """

    cube_half: Range = (0.0225, 0.0225)
    drop: Range = (0.004, 0.012)
    detour: Range = (0.0, 0.03)
    noise: Range = (0.0, 0.02)


class Stack(PickAndPlace):
    """Paper appendix A.3: cube 2 on cube 1, then cube 3 on both.

    Subtasks: `scripted`, and `adapted`: pieces of ten scripted demonstrations carried over to
    other layouts, more or less off their place, so that some fail.
    """

    name: ClassVar[str] = "stack"
    counts: ClassVar[Mapping[str, int]] = {"scripted": DEMONSTRATIONS, "adapted": 2200}
    default_subtask = "scripted"
    steps = 250
    config: StackConfig = StackConfig()

    def count_of_cubes(self, subtask: str, rng: np.random.Generator) -> int:
        """Three."""
        return 3

    def script(self, subtask: str, setting: Setting, rng: np.random.Generator) -> Script:
        """Where everything stands and what the arm does."""
        poses = scatter(setting, self.config, rng, gap=0.045)
        if subtask == "scripted":
            return Script(
                poses, _TOOL, lambda stage: self._scripted(stage, setting, rng), grip=OPEN
            )
        off, number = self._drawn(rng)
        return Script(poses, _TOOL, lambda stage: self._adapted(stage, off, number, rng), grip=OPEN)

    def source(self, seed: int) -> int:
        """Which demonstration the adapted episode of a seed is made of, 0 to 9."""
        rng = stream(seed, 1)
        scatter(self.setting("adapted", seed), self.config, rng, gap=0.045)
        return self._drawn(rng)[1]

    def success(self, subtask: str, setting: Setting, cubes: Floats) -> bool | None:
        """Each cube rests on the one before, and none moves any more."""
        end, halves = cubes[-1], np.array([cube.half for cube in setting.cubes])
        aside = np.linalg.norm(np.diff(end[:, :2], axis=0), axis=1)
        heights = np.cumsum(2 * halves) - halves
        stacked = (np.abs(end[:, 2] - heights) < 0.005).all() and (aside < halves[1:]).all()
        still = np.abs(cubes[-_STILL:] - end).max() < 0.001
        return bool(stacked and still)

    def _scripted(self, stage: Stage, setting: Setting, rng: np.random.Generator) -> Plan:
        top = 2 * setting.cubes[0].half
        yaw = stage.yaw("cube1")
        for index in (1, 2):
            x, y, _ = stage.position("cube1")
            goal = np.array(
                [x, y, top + setting.cubes[index].half + rng.uniform(*self.config.drop) / 4]
            )
            yield from self._carry(stage, setting, rng, index, goal, yaw)
            top += 2 * setting.cubes[index].half

    def _drawn(self, rng: np.random.Generator) -> tuple[float, int]:
        """How far pieces may be off, m, and the number of the demonstration."""
        return float(rng.uniform(*self.config.noise)), int(rng.integers(DEMONSTRATIONS))

    def _adapted(self, stage: Stage, off: float, number: int, rng: np.random.Generator) -> Plan:
        """The pieces of a demonstration, each moved with its cube and a little off."""
        now = (np.array(_TOOL), pointing_down(0.0))
        for piece in demonstration(number):
            here = piece.moved(frame_of(stage, piece.about), np.pi / 2)
            here = dataclasses.replace(here, pos=here.pos + rng.uniform(-off, off, 3) * [1, 1, 0])
            yield bridge(now, (here.pos[0], here.rot[0]), 0.25, self.control_timestep)
            yield from here.paths()
            now = here.pos[-1], here.rot[-1]
        yield Hold(1)


def frame_of(stage: Stage, cube: str) -> Frame:
    """Where a cube is."""
    return Frame(stage.position(cube), stage.yaw(cube))


@functools.cache
def demonstration(seed: int) -> tuple[Piece, ...]:
    """The pieces of a scripted episode: to the second cube, onto the first, and the same again."""
    task = Stack()
    setting, scene = task.setting("scripted", seed), task.scene("scripted", seed)
    script = task.script("scripted", setting, stream(seed, 1))
    arm = ArmController(task.arm)  # not that of the episode which asks for the demonstration
    rollout, _ = perform(scene.model, script, arm, task.steps, task.control_timestep)
    stage = Stage(scene.model)
    pos, rot = commanded(rollout.action, np.array(_TOOL), pointing_down(0.0))
    pieces, first = [], 0
    ends = _ends(rollout, pos[:, 2])
    for about, last in zip(("cube2", "cube1", "cube3", "cube2"), ends, strict=True):
        stage.data.qpos[:] = rollout.qpos[first]
        piece = slice(first, last)
        grip = rollout.action[piece, 6]
        pieces.append(Piece(about, frame_of(stage, about), pos[piece], rot[piece], grip))
        first = last
    return tuple(pieces)


def _ends(rollout: Rollout, height: Floats) -> list[int]:
    """Where pieces end: when the tool is up again after its grip changed."""
    changes = np.flatnonzero(np.diff(rollout.action[:, 6])) + 1
    return [int(change + np.argmax(height[change:] > _HIGH)) + 1 for change in changes]
