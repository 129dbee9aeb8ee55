"""What tasks with an arm and a table have in common."""

from __future__ import annotations

import abc
import functools
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.scene import Scene
from orbisim.state import State
from orbisim.tasks import assets
from orbisim.tasks.arm import ArmConfig, ArmController
from orbisim.tasks.base import Scripted, Task
from orbisim.tasks.episode import Episode, Rollout
from orbisim.tasks.sampling import stream
from orbisim.tasks.staging import Script, opening_pose, perform
from orbisim.tasks.tabletop import Setting, TabletopConfig, build, draw_setting
from orbisim.tasks.views import Cast, free_bodies, make_episode

Floats = npt.NDArray[np.float64]


@functools.cache
def controller(config: ArmConfig) -> ArmController:
    """The controller of an arm; one for each process, reset by every episode."""
    return ArmController(config)


class ArmTask(Task):
    """An arm moves cubes on a table, at 20 Hz, by actions of its end effector.

    Attributes:
      arm: the arm.
      asset: folder of the scene; the task's name if empty.
      steps: number of control steps of an episode.
    """

    arm: ArmConfig
    asset: str = ""
    steps: int
    control_timestep = 0.05
    config: Any = TabletopConfig()

    @property
    def horizon(self) -> float:  # type: ignore[override]
        """Duration of an episode, s."""
        return self.steps * self.control_timestep

    @abc.abstractmethod
    def count_of_cubes(self, subtask: str, rng: np.random.Generator) -> int:
        """How many cubes the scene has."""

    @abc.abstractmethod
    def script(self, subtask: str, setting: Setting, rng: np.random.Generator) -> Script:
        """Where everything stands and what the arm does."""

    def success(self, subtask: str, setting: Setting, cubes: Floats) -> bool | None:
        """The task's measure of success, from positions [T+1, cubes, 3]; None if it has none."""
        return None

    def setting(self, subtask: str, seed: int) -> Setting:
        """The physical parameters of an episode."""
        rng = stream(seed, 0)
        return draw_setting(self.config, self.count_of_cubes(subtask, rng), rng)

    def scene(self, subtask: str | None = None, seed: int | None = None) -> Scene:
        """A scene drawn from the distribution; the nominal one, as in the asset, without a seed.

        Its first keyframe, `start`, is where the episode begins.
        """
        name = self.check_subtask(subtask)
        if seed is None:
            return assets.scene(assets.spec(self.asset or self.name), self.label)
        setting = self.setting(name, seed)
        script = self.script(name, setting, stream(seed, 1))
        pose = opening_pose(script, controller(self.arm))
        return build(self.asset or self.name, setting, self.label, *pose)

    def episode(self, subtask: str, seed: int) -> Episode:
        """One episode."""
        scene, setting = self.scene(subtask, seed), self.setting(subtask, seed)
        rollout, _ = self._perform(scene.model, setting, subtask, seed)
        names = free_bodies(scene.model)
        fingers = ("left_finger", "right_finger")
        cast = Cast(names, robot=self.arm.site, surface="table", gripper=fingers)
        return make_episode(
            scene.model,
            cast,
            rollout,
            subtask=subtask,
            seed=seed,
            scene_hash=scene.fingerprint,
            control_timestep=self.control_timestep,
            success=self.success(subtask, setting, cube_positions(scene.model, rollout)),
        )

    def trials(self, count: int, seed: int, subtask: str | None = None) -> Scripted:
        """Episodes on one scene, with the policy's controls."""
        name = self.check_subtask(subtask)
        scene, setting = self.scene(name, seed), self.setting(name, seed)
        runs = [self._perform(scene.model, setting, name, seed + i) for i in range(count)]
        sequence = np.stack([rollout.ctrl for rollout, _ in runs])
        initial = State.stack([state for _, state in runs])
        return Scripted(scene, initial, sequence, self.control_timestep)

    def _perform(
        self, model: mujoco.MjModel, setting: Setting, subtask: str, seed: int
    ) -> tuple[Rollout, State]:
        script = self.script(subtask, setting, stream(seed, 1))
        arm = controller(self.arm)
        return perform(model, script, arm, self.steps, self.control_timestep)


def cube_positions(model: mujoco.MjModel, rollout: Rollout) -> Floats:
    """[T+1, cubes, 3], m."""
    addresses = [int(model.joint(name).qposadr[0]) for name in free_bodies(model)]
    return np.stack([rollout.qpos[:, a : a + 3] for a in addresses], axis=1)
