"""`task:ball`: a ball thrown at a wall and a floor."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from orbisim.episodes import Episodes
from orbisim.scene import Scene
from orbisim.tasks import assets
from orbisim.tasks.ball_reference import BallConfig, Floats, simulate
from orbisim.tasks.base import Task
from orbisim.tasks.episode import Episode, clock
from orbisim.tasks.sampling import Range, stream
from orbisim.tasks.single import passive_rollout, passive_trials
from orbisim.tasks.views import Cast, make_episode


@functools.cache
def _scene(label: str) -> Scene:
    return assets.scene(assets.spec("ball"), label)


@dataclasses.dataclass(frozen=True)
class BallRanges:
    """Initial velocities of the data, m/s."""

    velocity_x: Range = (-1.0, 1.0)
    velocity_y: Range = (3.0, 13.0)
    velocity_z: Range = (-7.0, -2.0)


class Ball(Task):
    """Newton's diffsim_ball; the data come from its own dynamics (`ball_reference`).

    The scene is the same in MJCF as far as MJCF goes: its contact damps on both ways, so that the
    damping is set for the same speed after a bounce.
    """

    name: ClassVar[str] = "ball"
    counts: ClassVar[Mapping[str, int]] = {"throw": 500}
    default_subtask = "throw"
    control_timestep = 1 / 60
    horizon = 0.6
    config: BallRanges = BallRanges()
    constants = BallConfig()

    def scene(self, subtask: str | None = None, seed: int | None = None) -> Scene:
        """The scene; it does not vary."""
        self.check_subtask(subtask)
        return _scene(self.label)

    def episode(self, subtask: str, seed: int) -> Episode:
        """One throw."""
        scene = self.scene(subtask)
        positions, velocities = simulate(self._velocity(seed), config=self.constants)
        time = clock(len(positions) - 1, self.control_timestep)
        rest = np.zeros((len(time), 3))
        upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(time), 1))
        return make_episode(
            scene.model,
            Cast(("ball",), surface="floor"),
            passive_rollout(time, np.hstack([positions, upright]), np.hstack([velocities, rest])),
            subtask=subtask,
            seed=seed,
            scene_hash=scene.fingerprint,
            control_timestep=self.control_timestep,
        )

    def trials(self, count: int, seed: int, subtask: str | None = None) -> Episodes:
        """Throws in the MJCF scene."""
        velocities = np.array([self._velocity(seed + i) for i in range(count)])
        start = np.array([*self.constants.start, 1.0, 0.0, 0.0, 0.0])
        qvel = np.hstack([velocities, np.zeros((count, 3))])
        qpos = np.tile(start, (count, 1))
        return passive_trials(self.scene(subtask), qpos, qvel, self.horizon, self.control_timestep)

    def _velocity(self, seed: int) -> Floats:
        rng = stream(seed, 1)
        config = self.config
        ranges = (config.velocity_x, config.velocity_y, config.velocity_z)
        return np.array([rng.uniform(*r) for r in ranges])
