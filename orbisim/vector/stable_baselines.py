"""A `VectorEnvironment` as a Stable-Baselines3 `VecEnv`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from dm_env import specs

from orbisim.errors import InputError, MissingDependencyError
from orbisim.vector.environment import FLAT, VectorEnvironment

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise MissingDependencyError("orbisim.vector.stable_baselines", "sb3", str(error)) from None

_ATTRIBUTES = {"render_mode": None}
"""What a world has of the attributes that Stable-Baselines3 asks for."""


class AlikeWorlds(VecEnv):
    """Worlds that are stepped together and have nothing of their own to get, set or call."""

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: worlds have no attributes of their own."""
        raise InputError(f"worlds have no attribute {attr_name!r} of their own to set")

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Refused: worlds have no methods of their own."""
        raise InputError(f"worlds have no method {method_name!r} of their own to call")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Whether worlds are wrapped one by one: never."""
        return [False for _ in self._get_indices(indices)]


class StableBaselinesVecEnv(AlikeWorlds):
    """Many worlds as Stable-Baselines3 sees them.

    Observations are float32, a `Dict` by dm_control's names (`MultiInputPolicy`) or one `Box` if
    the environment was loaded with `flat_observation` (`MlpPolicy`). A world whose episode ends is
    reset in the same step, as Stable-Baselines3 has it: the last observation is in
    `infos[i]["terminal_observation"]`, and `infos[i]["TimeLimit.truncated"]` says whether it was
    cut short. `infos[i]["diverged"]` is there if the world diverged.

    Args:
      environment: with NumPy arrays.

    Raises:
      InputError: the environment gives tensors, or observations that are no numbers.
    """

    def __init__(self, environment: VectorEnvironment) -> None:
        if environment.arrays != "numpy":
            raise InputError("Stable-Baselines3 takes NumPy arrays; load with arrays='numpy'")
        self.environment = environment
        boxes = {n: _box(s) for n, s in environment.observation_spec().items()}
        self._is_flat = list(boxes) == [FLAT]
        space = boxes[FLAT] if self._is_flat else gymnasium.spaces.Dict(boxes)
        super().__init__(environment.nworld, space, _actions(environment.action_spec()))
        self._actions: npt.NDArray[Any] | None = None

    def reset(self) -> Any:
        """Starts an episode in every world, with the seeds that `seed` has left."""
        seeds = [None if seed is None else int(seed) for seed in self._seeds]
        self._reset_seeds()
        self._reset_options()
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        return self._observed(self.environment.reset(seeds))

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Keeps the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, npt.NDArray[Any], npt.NDArray[Any], list[dict[str, Any]]]:
        """One control step in every world; resets those whose episode has ended."""
        before = self.environment.diverged.copy()
        step = self.environment.step(self._actions)
        observed, done = self._observed(step.observation), step.terminated | step.truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for world in np.flatnonzero(done):
            infos[world] = {
                "terminal_observation": self._of_world(observed, int(world)),
                "TimeLimit.truncated": bool(step.truncated[world]),
            }
        for world in np.flatnonzero(self.environment.diverged > before):
            infos[world]["diverged"] = True
        if done.any():
            observed = self._observed(self.environment.restart(done))
        return observed, step.reward.astype(np.float32), done, infos

    def close(self) -> None:
        """Frees the worlds."""
        self.environment.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of each world: of the environment, which is one for all."""
        value = _ATTRIBUTES.get(attr_name)
        if attr_name not in _ATTRIBUTES:
            value = getattr(self.environment, attr_name)
        return [value for _ in self._get_indices(indices)]

    def _observed(self, observation: dict[str, npt.NDArray[Any]]) -> Any:
        rows = {
            n: r.astype(np.float32).reshape(len(r), *(r.shape[1:] or (1,)))
            for n, r in observation.items()
        }
        return rows[FLAT] if self._is_flat else rows

    def _of_world(self, observed: Any, world: int) -> Any:
        if self._is_flat:
            return observed[world]
        return {name: rows[world] for name, rows in observed.items()}


def _box(spec: specs.Array) -> gymnasium.spaces.Box:
    if spec.dtype.kind not in "biuf":
        raise InputError(f"observation {spec.name!r} is made of {spec.dtype}, not of numbers")
    return gymnasium.spaces.Box(-np.inf, np.inf, spec.shape or (1,), np.float32)


def _actions(spec: specs.BoundedArray) -> gymnasium.spaces.Box:
    bounds: Sequence[Any] = (spec.minimum, spec.maximum)
    low, high = (np.broadcast_to(b, spec.shape).astype(np.float32) for b in bounds)
    return gymnasium.spaces.Box(low, high, dtype=np.float32)
