"""Rewards, observations and ends of episodes: the task's own functions, for all worlds.

`Batched` calls them once over a physics whose arrays are `Worlds`; `WorldByWorld` calls them on a
dm_control `Physics` that takes the state of one world after the other. Both give the same bits;
`disagreement` compares them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from dm_control.mujoco import engine

from orbisim.vector.models import ModelFields
from orbisim.vector.physics import Fields, Selection, batched
from orbisim.vector.simulator import Threads
from orbisim.vector.tasks import Tasks
from orbisim.vector.worlds import NotBatchedError, Worlds, WorldsDifferError

Ids = npt.NDArray[np.int64]
Rows = npt.NDArray[Any]


@dataclasses.dataclass(frozen=True)
class Values:
    """What the task says of some worlds.

    Attributes:
      observation: by name, each [n, ...].
      reward: [n].
      discount: [n]; NaN where the episode goes on.
    """

    observation: Mapping[str, Rows]
    reward: Rows
    discount: Rows


class Evaluator(Protocol):
    """Computes what the task says of some worlds."""

    def values(self, ids: Ids) -> Values:
        """Of the worlds `ids`, in their order."""


class WorldByWorld:
    """Calls the task's functions on one world after the other.

    Args:
      physics: takes the state of each world in turn.
    """

    def __init__(
        self, physics: engine.Physics, simulator: Threads, fields: ModelFields, tasks: Tasks
    ) -> None:
        self._physics, self._simulator = physics, simulator
        self._fields, self._tasks = fields, tasks

    def at(self, world: int) -> engine.Physics:
        """The physics in the state of a world."""
        self._fields.place(world)
        self._simulator.fill(world, self._physics.data.ptr)
        return self._physics

    def values(self, ids: Ids) -> Values:
        """See `Evaluator`."""
        found = [self._one(int(world)) for world in ids]
        names = found[0][0]
        return Values(
            observation={n: np.stack([np.array(f[0][n]) for f in found]) for n in names},
            reward=np.array([f[1] for f in found], np.float64),
            discount=np.array([np.nan if f[2] is None else f[2] for f in found], np.float64),
        )

    def _one(self, world: int) -> tuple[Mapping[str, Any], Any, Any]:
        physics, task = self.at(world), self._tasks.each[world]
        reward = task.get_reward(physics)
        return task.get_observation(physics), reward, task.get_termination(physics)


class FieldsOf(Fields, Protocol):
    """Gives a field of MjData in `nworld` worlds."""

    nworld: int


class Batched:
    """Calls the task's functions once for all worlds, and once more for each side of a branch.

    Args:
      physics: of one world, not changed by any task; gives names and methods.
    """

    def __init__(
        self, physics: engine.Physics, simulator: FieldsOf, fields: ModelFields, tasks: Tasks
    ) -> None:
        self._tasks, self._selection = tasks, Selection()
        self._nworld = simulator.nworld
        self._physics = batched(physics, simulator, fields.varied, self._selection)

    def values(self, ids: Ids) -> Values:
        """See `Evaluator`.

        Raises:
          NotBatchedError: a function of the task cannot be called for many worlds.
        """
        with np.errstate(all="ignore"):  # as many warnings as worlds, of what is checked later
            observed = self._divided(ids, lambda task: task.get_observation(self._physics))
            reward = self._divided(ids, lambda task: task.get_reward(self._physics))
            discount = self._divided(ids, lambda task: task.get_termination(self._physics))
        ended = [(part, np.nan if value is None else value) for part, value in discount]
        names = observed[0][1]
        return Values(
            observation={
                name: _joined(ids, [(part, one[name]) for part, one in observed]) for name in names
            },
            reward=_joined(ids, reward).astype(np.float64, copy=False),
            discount=_joined(ids, ended).astype(np.float64, copy=False),
        )

    def _divided(self, ids: Ids, function: Callable[[Any], Any]) -> list[tuple[Ids, Any]]:
        """The results of a function for parts of the worlds in which it takes the same branches."""
        self._selection.ids = None if len(ids) == self._nworld else ids
        task = self._tasks.together(self._selection.ids)
        before = dict(vars(task))
        try:
            result = function(task)
        except WorldsDifferError as branch:
            sides = (ids[branch.mask], ids[~branch.mask])
            return [part for side in sides for part in self._divided(side, function)]
        after = vars(task)
        if after.keys() != before.keys() or any(after[k] is not before[k] for k in after):
            raise NotBatchedError("a task that keeps something when it is asked for a value")
        return [(ids, result)]


def _joined(ids: Ids, parts: list[tuple[Ids, Any]]) -> Rows:
    """The rows of all parts in the order of `ids`."""
    rows = [_rows(value, len(part)) for part, value in parts]
    if len(rows) == 1:
        return np.array(rows[0])
    if len({r.shape[1:] for r in rows}) > 1:
        raise NotBatchedError("an observation of different shapes in different worlds")
    order = np.argsort(np.concatenate([part for part, _ in parts]), kind="stable")
    joined = np.concatenate(rows)[order]
    return joined[np.argsort(np.argsort(ids, kind="stable"), kind="stable")]


def _rows(value: Any, count: int) -> Rows:
    if isinstance(value, Worlds):
        return value.rows
    one = np.asarray(value)
    if one.dtype == object:
        raise NotBatchedError(f"an observation or a reward that is a {type(value).__name__}")
    return np.broadcast_to(one, (count, *one.shape))


def disagreement(a: Evaluator, b: Evaluator, ids: Ids) -> str:
    """What differs between two evaluators in some worlds; empty if nothing does, to the bit."""
    one, other = a.values(ids), b.values(ids)
    if list(one.observation) != list(other.observation):
        return f"observations {list(one.observation)}, not {list(other.observation)}"
    pairs = {name: (rows, other.observation[name]) for name, rows in one.observation.items()}
    pairs |= {n: (getattr(one, n), getattr(other, n)) for n in ("reward", "discount")}
    for name, (mine, theirs) in pairs.items():
        if mine.shape != theirs.shape:
            return f"{name} of shape {mine.shape[1:]}, not {theirs.shape[1:]}"
        if not np.array_equal(mine, theirs, equal_nan=True):
            return f"{name} differs by up to {np.nanmax(np.abs(mine - theirs)):.1e}"
    return ""
