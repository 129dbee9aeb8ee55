"""Scenes with a reward as vector environments."""

from __future__ import annotations

import collections
from collections.abc import Callable, Mapping
from typing import Any, Literal

from dm_control.rl import control
from dm_control.suite import base

from orbisim.arguments import positive_number
from orbisim.backend import Backend
from orbisim.errors import InputError
from orbisim.physics import Physics
from orbisim.scene import Scene, SceneSource, load_scene
from orbisim.vector.environment import VectorEnvironment
from orbisim.vector.loading import from_environment
from orbisim.vector.randomization import Draw, Intervals


class SceneTask(base.Task):
    """A task made of functions of a dm_control `Physics` (see `from_scene`)."""

    def __init__(
        self,
        reward: Callable[[Any], Any],
        observation: Callable[[Any], Mapping[str, Any]] | None,
        termination: Callable[[Any], Any] | None,
        initialize: Callable[[Any, Any], None] | None,
        random: Any = None,
    ) -> None:
        super().__init__(random=random)
        self._reward, self._observation = reward, observation
        self._termination, self._initialize = termination, initialize

    def initialize_episode(self, physics: Any) -> None:
        """Begins an episode."""
        if self._initialize is not None:
            self._initialize(physics, self.random)
        super().initialize_episode(physics)

    def get_reward(self, physics: Any) -> Any:
        """The reward."""
        return self._reward(physics)

    def get_observation(self, physics: Any) -> Mapping[str, Any]:
        """The observation; positions and velocities if no other was given."""
        if self._observation is not None:
            return self._observation(physics)
        return collections.OrderedDict(position=physics.position(), velocity=physics.velocity())

    def get_termination(self, physics: Any) -> float | None:
        """Discount 0 where the episode has ended."""
        if self._termination is not None and self._termination(physics):
            return 0.0
        return None


def from_scene(
    scene: SceneSource,
    nworld: int,
    *,
    reward: Callable[[Any], Any],
    observation: Callable[[Any], Mapping[str, Any]] | None = None,
    termination: Callable[[Any], Any] | None = None,
    initialize: Callable[[Any, Any], None] | None = None,
    time_limit: float = float("inf"),
    control_timestep: float | None = None,
    backend: str | Backend = "mujoco",
    device: str | None = None,
    seed: int | None = None,
    randomize: Mapping[str, Draw] | Intervals | None = None,
    nthread: int = 0,
    arrays: Literal["numpy", "torch"] = "numpy",
) -> VectorEnvironment:
    """Runs a scene with a reward in many worlds.

    The functions are written for one world's dm_control `Physics`, as a dm_control task's are.

    Args:
      scene: anything that `load_scene` loads (`task:push`, a path, a text).
      nworld: number of worlds.
      reward: physics to a number.
      observation: physics to arrays by name; positions and velocities if None.
      termination: physics to whether the episode has ended.
      initialize: sets the first state of an episode from the physics and a `RandomState`; the
        scene's own if None.
      time_limit: of an episode, s. control_timestep: duration of a step, s; a timestep if None.
      backend, device, seed, randomize, nthread, arrays: see `load`. `intervals(report)` as
        `randomize` draws each world's scene from a diagnosis, once.

    Raises:
      InputError: a duration, the scene or what is drawn does not fit.
      SceneError: the scene cannot be read.
    """
    loaded = load_scene(scene)
    if time_limit != float("inf"):
        positive_number("time_limit", time_limit)
    if control_timestep is not None:
        _check_control_timestep(loaded, positive_number("control_timestep", control_timestep))
    drawn = randomize if isinstance(randomize, Intervals) else None

    def make_environment(random: int) -> control.Environment:
        world = loaded if drawn is None else drawn.draw(loaded, random)
        task = SceneTask(reward, observation, termination, initialize, random=random)
        return control.Environment(
            Physics.from_scene(world),
            task,
            time_limit=time_limit,
            control_timestep=control_timestep,
        )

    return from_environment(
        make_environment,
        nworld,
        backend,
        device,
        seed=seed,
        name=loaded.name,
        randomize=None if isinstance(randomize, Intervals) else randomize,
        one_by_one=drawn is not None,
        nthread=nthread,
        arrays=arrays,
    )


def _check_control_timestep(scene: Scene, step: float) -> None:
    ratio = step / float(scene.model.opt.timestep)
    if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < 1:
        raise InputError(
            f"control_timestep is {step:g} s; scene {scene.name!r} has timesteps of "
            f"{scene.model.opt.timestep:g} s, and it must be a multiple of them"
        )
