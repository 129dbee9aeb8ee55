"""A `VectorEnvironment` as TorchRL's environments are: dictionaries of tensors in and out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from orbisim.errors import InputError
from orbisim.vector.environment import VectorEnvironment


class TensorEnvironment:
    """Dictionaries of tensors with TorchRL's keys and shapes; needs torch alone.

    `TensorDict(environment.reset(), batch_size=[nworld])` and the like take them without a copy.
    Worlds whose episode is over are reset by `reset({"_reset": done})`; those that nobody resets
    are by their next step (see `VectorEnvironment`).

    Args:
      environment: with tensors.

    Raises:
      InputError: the environment gives NumPy arrays.
    """

    def __init__(self, environment: VectorEnvironment) -> None:
        if environment.arrays != "torch":
            raise InputError("TensorEnvironment gives tensors; load with arrays='torch'")
        self.environment = environment
        self.batch_size = (environment.nworld,)

    def reset(self, values: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Starts episodes.

        Args:
          values: `_reset` [nworld] or [nworld, 1] says in which worlds; in all if it is not there.

        Returns:
          Observations by name and `done`, `terminated`, `truncated` [nworld, 1], all False.
        """
        mask = None if values is None else values.get("_reset")
        if mask is None:
            observation = self.environment.reset()
        else:
            mask = mask.detach().cpu() if hasattr(mask, "detach") else mask
            observation = self.environment.restart(np.asarray(mask).reshape(-1))
        nothing = next(iter(observation.values())).new_zeros((*self.batch_size, 1)).bool()
        ends = {name: nothing.clone() for name in ("done", "terminated", "truncated")}
        return {**observation, **ends}

    def step(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """One control step.

        Args:
          values: `action` [nworld, nu].

        Returns:
          What was given, and under `next` observations by name and `reward`, `done`, `terminated`,
          `truncated`, each [nworld, 1].
        """
        if "action" not in values:
            raise InputError(f"a step needs 'action'; got {', '.join(values) or 'nothing'}")
        step = self.environment.step(values["action"])
        ends = {"terminated": step.terminated, "truncated": step.truncated}
        ends["done"] = step.terminated | step.truncated
        columns = {"reward": step.reward, **ends}
        return {
            **values,
            "next": {**step.observation, **{n: c[:, None] for n, c in columns.items()}},
        }
