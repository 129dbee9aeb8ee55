"""Calls hooks at every timestep of a batched simulation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.effects.base import Hook, StepInputs

Floats = npt.NDArray[np.float64]

CHANGED_FIELDS = ("dof_frictionloss",)
"""Model fields that hooks may give per-world values."""

ACCELERATION_STAGE = frozenset({"qfrc_actuator", "qfrc_constraint"})


def derived_of(hooks: Sequence[Hook]) -> frozenset[str]:
    """Derived fields that the hooks read."""
    return frozenset().union(*(hook.derived for hook in hooks))


def stage_of(derived: frozenset[str]) -> mujoco.mjtStage:
    """The forward stage after which the derived fields are known."""
    if derived & ACCELERATION_STAGE:
        return mujoco.mjtStage.mjSTAGE_ACC
    return mujoco.mjtStage.mjSTAGE_VEL if derived else mujoco.mjtStage.mjSTAGE_NONE


def changes_fields(hooks: Sequence[Hook]) -> bool:
    """Whether any hook changes a model field."""
    return any(type(hook).fields is not Hook.fields for hook in hooks)


class HookRunner:
    """Prepares the inputs of one timestep.

    Args:
      model: the model, read-only.
      hooks: what to apply.
    """

    def __init__(self, model: mujoco.MjModel, hooks: Sequence[Hook]) -> None:
        self._model, self._hooks = model, hooks
        self.derived = derived_of(hooks)
        self.fields = CHANGED_FIELDS if changes_fields(hooks) else ()

    def inputs(
        self,
        read: Callable[[str], Any],
        ctrl: Floats,
        applied: Mapping[str, Floats],
        base: Mapping[str, Floats],
    ) -> StepInputs:
        """The controls, applied forces and model fields of the next timestep.

        Args:
          read: gives `time`, `qpos`, `qvel` or a derived field, [nworld, ...].
          ctrl: [nworld, nu] as commanded.
          applied: `qfrc_applied` and `xfrc_applied` as set by the user.
          base: declared values of the model fields that hooks change, [nworld, ...].
        """
        inputs = StepInputs(
            model=self._model,
            time=read("time"),
            qpos=read("qpos"),
            qvel=read("qvel"),
            ctrl=np.array(ctrl, np.float64),
            qfrc=np.array(applied["qfrc_applied"], np.float64),
            xfrc=np.array(applied["xfrc_applied"], np.float64),
            derived={name: read(name) for name in self.derived},
            fields={name: np.array(base[name], np.float64) for name in self.fields},
        )
        for hook in self._hooks:
            hook.control(inputs)
            hook.force(inputs)
            hook.fields(inputs)
        return inputs
