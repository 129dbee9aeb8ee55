"""Rewards, observations and ends of episodes on a device, by the task's own functions."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import torch
from dm_control.mujoco import engine

from orbisim.backend import InPlace
from orbisim.vector.evaluation import Values
from orbisim.vector.models import ModelFields
from orbisim.vector.physics import batched
from orbisim.vector.tasks import Tasks, same
from orbisim.vector.tensor_worlds import Context, TensorWorlds, merged, torch_dtype
from orbisim.vector.worlds import NotBatchedError, Worlds

TOLERANCE = 1e-12
"""How far values on the device may be from the host's, relative to the larger of 1 and the field's
largest: both are computed in float64 from the same numbers, in another order."""


@dataclasses.dataclass(frozen=True)
class DeviceValues:
    """What the task says of all worlds, on the device.

    Attributes:
      observation: by name, each [nworld, ...].
      reward: [nworld] float64.
      discount: [nworld] float64; NaN where the episode goes on.
    """

    observation: Mapping[str, torch.Tensor]
    reward: torch.Tensor
    discount: torch.Tensor


class DeviceFields:
    """MjData's fields in every world, in the types that NumPy has them in.

    A field is converted once between two calls of `forget`.

    Args:
      worlds: whose fields.
      model: of every world.
      given: by name, fields [nworld, ...] in float64 that the device's own are rounded from (time,
        controls); their memory stays where it is.
    """

    def __init__(
        self, worlds: InPlace, model: mujoco.MjModel, given: Mapping[str, torch.Tensor]
    ) -> None:
        self.model, self._worlds, self._given = model, worlds, given
        self._one = mujoco.MjData(model)
        self._known: dict[str, torch.Tensor] = {}

    def field(self, name: str) -> torch.Tensor:
        """[nworld, ...].

        Raises:
          NotBatchedError: the device does not have it.
        """
        if name not in self._worlds.names:
            raise NotBatchedError(f"physics.data.{name} on the device")
        if name not in self._known:
            kind = torch_dtype(np.asarray(getattr(self._one, name)).dtype)
            rows = self._given.get(name)
            rows = self._worlds.field(name) if rows is None else rows
            self._known[name] = rows.to(kind, copy=True)
        return self._known[name]

    def forget(self) -> None:
        """The fields have other values now."""
        self._known = {}


class HostFields:
    """The same fields on the host, for a comparison.

    Args:
      fields: on the device. nworld: number of worlds.
    """

    def __init__(self, fields: DeviceFields, nworld: int) -> None:
        self.model, self.nworld, self._fields = fields.model, nworld, fields

    def field(self, name: str) -> Any:
        """[nworld, ...]."""
        return self._fields.field(name).cpu().numpy()


class _Frozen:
    """Makes arrays of fields that no task may write into."""

    def __init__(self, context: Context) -> None:
        self._context = context

    def of(self, rows: torch.Tensor) -> TensorWorlds:
        return TensorWorlds(rows, self._context, frozen=True)


class DeviceEvaluator:
    """Calls the task's functions once for all worlds, and for each way through their branches.

    Args:
      physics: of one world, not changed by any task; gives names and methods.
      fields: of all worlds.
      models: what differs in their models; nothing may.
      tasks: of all worlds.
      device: where the fields are.

    Attributes:
      version: grows whenever the functions may do other operations than before.
    """

    def __init__(
        self,
        physics: engine.Physics,
        fields: DeviceFields,
        models: ModelFields,
        tasks: Tasks,
        device: Any,
    ) -> None:
        self._fields, self._models, self._tasks = fields, models, tasks
        self._context = Context(device, len(tasks.each))
        self._physics = batched(physics, fields, models.varied, _Frozen(self._context))
        self._task: Any = None
        self._seen = -1
        self._attributes: dict[str, Any] = {}
        self.version = 0

    def values(self) -> DeviceValues:
        """Of all worlds; launches operations and waits for none.

        Raises:
          NotBatchedError: something of the task cannot be computed so.
        """
        self.prepare()
        self._fields.forget()
        task, physics = self._task, self._physics
        before = dict(vars(task))
        paths, context = self._context.paths, self._context
        with np.errstate(all="ignore"):
            observed = paths.of(lambda: task.get_observation(physics))
            reward = paths.of(lambda: task.get_reward(physics))
            ended = paths.of(lambda: task.get_termination(physics))
        if vars(task).keys() != before.keys() or any(
            value is not before[name] for name, value in vars(task).items()
        ):
            raise NotBatchedError("a task that keeps something when it is asked for a value")
        ends = [(mask, np.nan if value is None else value) for mask, value in ended]
        if len({tuple(one) for _, one in observed}) > 1:
            raise NotBatchedError("observations of different names in different worlds")
        names = observed[0][1]
        return DeviceValues(
            observation={
                name: merged([(mask, one[name]) for mask, one in observed], context)
                for name in names
            },
            reward=self._numbers(reward),
            discount=self._numbers(ends),
        )

    def prepare(self) -> None:
        """Takes what the tasks have set since it was last asked.

        Raises:
          NotBatchedError: something differs from world to world that the device cannot hold.
        """
        if self._models.varied:
            names = ", ".join(map(repr, self._models.varied))
            raise NotBatchedError(f"models that differ from world to world ({names})")
        if self._seen == self._tasks.changes:
            return
        task = self._tasks.together(None)
        for name, value in vars(task).items():
            if isinstance(value, Worlds):
                setattr(task, name, self._attribute(name, value))
            elif name not in self._attributes or not same(self._attributes[name], value):
                kept = isinstance(value, list | dict | set | np.ndarray)
                self._attributes[name] = copy.deepcopy(value) if kept else value
                self.version += 1
        self._task, self._seen = task, self._tasks.changes

    def _attribute(self, name: str, value: Worlds) -> TensorWorlds:
        """An attribute that differs between worlds: in the memory that it had before."""
        rows = torch.from_numpy(np.array(value.rows)).to(torch_dtype(value.dtype))
        known = self._attributes.get(name)
        if isinstance(known, TensorWorlds) and _alike(known.rows, rows):
            known.rows.copy_(rows)
            return known
        made = TensorWorlds(rows.to(self._context.device), self._context, frozen=True)
        self._attributes[name] = made
        self.version += 1
        return made

    def _numbers(self, parts: Any) -> torch.Tensor:
        rows = merged(parts, self._context).to(torch.float64)
        if rows.ndim != 1:
            raise NotBatchedError(f"a reward or a discount of shape {tuple(rows.shape[1:])}")
        return rows


def _alike(a: torch.Tensor, b: torch.Tensor) -> bool:
    return a.shape == b.shape and a.dtype == b.dtype


def differences(found: Mapping[str, torch.Tensor], expected: Values, worlds: Any) -> str:
    """What differs in some worlds beyond rounding between the device and the host; or nothing.

    Args:
      found: by name, each [nworld, ...]: the observations, `reward` and `discount`.
      expected: of the host, of the same worlds.
      worlds: their numbers.
    """
    pairs = {**expected.observation, "reward": expected.reward, "discount": expected.discount}
    if list(found) != list(pairs):
        return f"{list(found)} on the device, not {list(pairs)}"
    for name, theirs in pairs.items():
        mine, theirs = found[name].cpu().numpy()[worlds], np.asarray(theirs)
        if mine.shape != theirs.shape:
            return f"{name} of shape {mine.shape[1:]} on the device, not {theirs.shape[1:]}"
        mine, theirs = mine.astype(np.float64), theirs.astype(np.float64)
        scale = max(1.0, float(np.max(np.abs(theirs[np.isfinite(theirs)]), initial=0.0)))
        if not np.allclose(mine, theirs, rtol=0.0, atol=TOLERANCE * scale, equal_nan=True):
            worst = float(np.nanmax(np.abs(mine - theirs)))
            return f"{name} differs by up to {worst:.1e} on the device"
    return ""
