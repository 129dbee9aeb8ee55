"""`task:toss`: a cube or a box thrown on a plane."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import mujoco
import numpy as np

from orbisim.episodes import Episodes
from orbisim.scene import Scene
from orbisim.tasks import assets
from orbisim.tasks.base import Task
from orbisim.tasks.episode import Episode, Floats, Rollout, check_stable, clock
from orbisim.tasks.sampling import Range, stream
from orbisim.tasks.single import passive_rollout, passive_trials
from orbisim.tasks.views import Cast, make_episode

_SUBSTEPS = 10
"""Timesteps for each sample: the recordings have 148 samples a second."""


@dataclasses.dataclass(frozen=True)
class TossConfig:
    """What a toss is drawn from.

    Attributes:
      cube_half: half side of the cubes, m. box_half: half sides of the boxes, m.
      density: kg/m^3. friction: sliding coefficient.
      time_constant, damping_ratio: of the contact (solref), s and 1; the less damped it is, the
        higher the box bounces.
      clearance: of the lowest corner at the start, m. horizontal, vertical: speeds, m/s.
      spin: angular speed, rad/s.
    """

    cube_half: Range = (0.048, 0.056)
    box_half: Range = (0.03, 0.08)
    density: Range = (150.0, 800.0)
    friction: Range = (0.05, 0.6)
    time_constant: Range = (0.003, 0.02)
    damping_ratio: Range = (0.3, 1.2)
    clearance: Range = (0.0, 0.15)
    horizontal: Range = (0.0, 1.8)
    vertical: Range = (-0.8, 0.6)
    spin: Range = (0.0, 10.0)


class Toss(Task):
    """A free box on a plane; sampled at 148 Hz as the measured tosses of `contactnets_cube`."""

    name: ClassVar[str] = "toss"
    counts: ClassVar[Mapping[str, int]] = {"cube": 1000, "box": 1000}
    default_subtask = "cube"
    control_timestep = 1 / 148
    horizon = 1.0
    config: TossConfig = TossConfig()

    def scene(self, subtask: str | None = None, seed: int | None = None) -> Scene:
        """A box of random shape, mass and contact on its plane."""
        name = self.check_subtask(subtask)
        spec = assets.spec("toss")
        if seed is not None:
            self._vary(spec, name, stream(seed, 0))
        return assets.scene(spec, self.label)

    def _vary(self, spec: mujoco.MjSpec, subtask: str, rng: np.random.Generator) -> None:
        config = self.config
        box = spec.geom("box")
        sides = [rng.uniform(*config.box_half) for _ in range(3)]
        cube = [rng.uniform(*config.cube_half)] * 3
        box.size = cube if subtask == "cube" else sides
        box.density = rng.uniform(*config.density)
        box.friction = [rng.uniform(*config.friction), 0.005, 0.0001]
        logs = np.log(config.time_constant)
        box.solref = [float(np.exp(rng.uniform(*logs))), rng.uniform(*config.damping_ratio)]
        box.rgba = [*rng.uniform(0.1, 0.9, 3), 1.0]

    def episode(self, subtask: str, seed: int) -> Episode:
        """One toss."""
        scene = self.scene(subtask, seed)
        qpos, qvel = self._throw(scene.model, seed)
        return make_episode(
            scene.model,
            Cast(("box",), surface="board"),
            self._simulate(scene.model, qpos, qvel),
            subtask=subtask,
            seed=seed,
            scene_hash=scene.fingerprint,
            control_timestep=self.control_timestep,
        )

    def trials(self, count: int, seed: int, subtask: str | None = None) -> Episodes:
        """Tosses of one box."""
        scene = self.scene(subtask, seed)
        throws = [self._throw(scene.model, seed + i) for i in range(count)]
        qpos, qvel = (np.array(part) for part in zip(*throws, strict=True))
        return passive_trials(scene, qpos, qvel, self.horizon, self.control_timestep)

    def _throw(self, model: mujoco.MjModel, seed: int) -> tuple[Floats, Floats]:
        """Initial qpos [7] and qvel [6] (angular velocity in the body's frame)."""
        rng, config = stream(seed, 1), self.config
        quat = rng.standard_normal(4)
        quat /= np.linalg.norm(quat)
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, quat)
        reach = float(np.abs(matrix.reshape(3, 3)[2]) @ model.geom("box").size)
        height = reach + rng.uniform(*config.clearance)
        heading, speed = rng.uniform(-np.pi, np.pi), rng.uniform(*config.horizontal)
        axis = rng.standard_normal(3)
        spin = rng.uniform(*config.spin) * axis / np.linalg.norm(axis)
        linear = [speed * np.cos(heading), speed * np.sin(heading), rng.uniform(*config.vertical)]
        return np.array([0.0, 0.0, height, *quat]), np.array([*linear, *spin])

    def _simulate(self, model: mujoco.MjModel, qpos: Floats, qvel: Floats) -> Rollout:
        steps = round(self.horizon / self.control_timestep)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = qpos, qvel
        positions, velocities = [qpos], [qvel]
        for _ in range(steps):
            mujoco.mj_step(model, data, _SUBSTEPS)
            positions.append(data.qpos.copy())
            velocities.append(data.qvel.copy())
        check_stable(data)
        time = clock(steps, self.control_timestep)
        return passive_rollout(time, np.array(positions), np.array(velocities))
