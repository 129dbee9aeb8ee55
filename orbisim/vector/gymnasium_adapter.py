"""A `VectorEnvironment` as a `gymnasium.vector.VectorEnv`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from dm_env import specs

from orbisim.errors import InputError, MissingDependencyError
from orbisim.vector.environment import FLAT, VectorEnvironment
from orbisim.vector.loading import load

try:
    import gymnasium
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError as error:
    raise MissingDependencyError("orbisim.vector.gym", "gym", str(error)) from None


class GymnasiumVectorEnv(VectorEnv):
    """Many worlds as gymnasium sees them.

    Observations are a `Dict` of `Box`es by dm_control's names, or one `Box` if the environment was
    loaded with `flat_observation`. Autoreset is `AutoresetMode.NEXT_STEP`. `info["diverged"]` and
    `info["_diverged"]` say which worlds diverged in a step.

    Args:
      environment: with NumPy arrays.

    Raises:
      InputError: the environment gives tensors.
    """

    def __init__(self, environment: VectorEnvironment) -> None:
        if environment.arrays != "numpy":
            raise InputError("gymnasium's spaces hold NumPy arrays; load with arrays='numpy'")
        self.environment = environment
        self.num_envs = environment.nworld
        self.metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}
        self.render_mode = None
        self.spec = None
        self.single_action_space = _action_space(environment.action_spec())
        self.single_observation_space = _observation_space(environment.observation_spec())
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Starts an episode in every world.

        Args:
          seed: world i draws from `seed + i`, or from the i-th of a sequence (None: goes on).
          options: none are known.

        Raises:
          InputError: the seeds are none, or not one for each world; there are options.
        """
        if options:
            raise InputError(f"reset knows no options; got {', '.join(map(str, options))}")
        return self._flat(self.environment.reset(seed)), {}

    def step(
        self, actions: npt.NDArray[Any]
    ) -> tuple[Any, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        """One control step in every world (see `VectorEnvironment.step`)."""
        before = self.environment.diverged.copy()
        step = self.environment.step(actions)
        lost = self.environment.diverged > before
        info = {"diverged": lost, "_diverged": lost} if lost.any() else {}
        return self._flat(step.observation), step.reward, step.terminated, step.truncated, info

    def close_extras(self, **kwargs: Any) -> None:
        """Frees the worlds."""
        self.environment.close()

    def _flat(self, observation: dict[str, Any]) -> Any:
        is_one = isinstance(self.single_observation_space, gymnasium.spaces.Box)
        return observation[FLAT] if is_one else observation


def gym(domain: str | VectorEnvironment, *args: Any, **kwargs: Any) -> GymnasiumVectorEnv:
    """A `gymnasium.vector.VectorEnv` of a task of dm_control's suite.

    Args:
      domain: a domain of the suite, and then whatever `orbisim.vector.load` takes; or a
        `VectorEnvironment` alone.

    Raises:
      InputError, UnknownNameError: see `orbisim.vector.load`.
      MissingDependencyError: gymnasium is not installed.
    """
    if not isinstance(domain, VectorEnvironment):
        return GymnasiumVectorEnv(load(domain, *args, **kwargs))
    if args or kwargs:
        raise InputError("gym(environment) takes nothing else; the environment is loaded already")
    return GymnasiumVectorEnv(domain)


def _action_space(spec: specs.BoundedArray) -> gymnasium.spaces.Box:
    low = np.broadcast_to(spec.minimum, spec.shape).astype(spec.dtype)
    high = np.broadcast_to(spec.maximum, spec.shape).astype(spec.dtype)
    return gymnasium.spaces.Box(low, high, dtype=spec.dtype.type)


def _observation_space(spec: dict[str, specs.Array]) -> gymnasium.Space[Any]:
    boxes = {n: _box(s) for n, s in spec.items()}
    return boxes[FLAT] if list(boxes) == [FLAT] else gymnasium.spaces.Dict(boxes)


def _box(spec: specs.Array) -> gymnasium.spaces.Box:
    if spec.dtype.kind == "f":
        return gymnasium.spaces.Box(-np.inf, np.inf, spec.shape, spec.dtype.type)
    low, high = (0, 1) if spec.dtype.kind == "b" else _limits(spec.dtype)
    return gymnasium.spaces.Box(low, high, spec.shape, spec.dtype.type)


def _limits(dtype: np.dtype[Any]) -> tuple[int, int]:
    limits = np.iinfo(dtype)
    return int(limits.min), int(limits.max)
