"""Calls hooks at every timestep of a batched simulation."""

from __future__ import annotations

import copy
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


def side_by_side(every: Sequence[Sequence[Hook]], each: int) -> list[Hook] | None:
    """Hooks for worlds of several scenes, one scene after the other; None where they differ in more
    than their values.

    Args:
      every: the hooks of each scene. each: worlds of each scene.
    """
    found: list[Hook] = []
    for same in zip(*every, strict=False):
        one = copy.copy(same[0])
        rest = [{k: v for k, v in vars(hook).items() if k != "values"} for hook in same]
        alike = all(
            type(hook) is type(one) and hook.values.keys() == one.values.keys() for hook in same
        )
        if not alike or any(not _equal(rest[0], other) for other in rest[1:]):
            return None
        if any(value.ndim for hook in same for value in hook.values.values()):
            return None
        one.values = {
            name: np.repeat(np.array([hook.values[name] for hook in same]), each)
            for name in one.values
        }
        found.append(one)
    return found if len({len(hooks) for hooks in every}) == 1 else None


def _equal(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether attributes are the same."""
    return one.keys() == other.keys() and all(
        type(one[name]) is type(other[name]) and np.array_equal(one[name], other[name])
        for name in one
    )


def same_physics(one: mujoco.MjModel, other: mujoco.MjModel) -> bool:
    """Whether two models simulate alike, whatever names and texts they have."""
    parts = ((one, other, _OF_MODEL), (one.opt, other.opt, _OF_OPTIONS))
    return all(
        np.array_equal(getattr(mine, name), getattr(others, name))
        for mine, others, names in parts
        for name in names
    )


def _numbers(kind: type) -> tuple[str, ...]:
    """Attributes of a model, or of its options, that are numbers of the simulation: neither methods
    nor what only stores names and texts (`ntextdata`, `names_map`)."""
    stored = ("_", "name", "text", "ntext", "nname", "signature", "nbuffer", "paths")
    known = (name for name in dir(kind) if not name.startswith(stored))
    return tuple(name for name in known if not callable(getattr(kind, name)) and name not in _OWN)


_OWN = {"opt", "vis", "stat"}
"""Structures of a model: options are compared apart, the others only say how it looks."""
_OF_MODEL, _OF_OPTIONS = _numbers(mujoco.MjModel), _numbers(mujoco.MjOption)


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
