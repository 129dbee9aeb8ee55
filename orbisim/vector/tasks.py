"""A task for each world, and one that stands for all of them when values are computed."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.vector.worlds import NotBatchedError, Worlds

Ids = npt.NDArray[np.int64]


class _NoRandomness:
    """In place of a task's random numbers while values of many worlds are computed."""

    def __getattr__(self, name: str) -> Any:
        raise NotBatchedError("a reward or an observation that draws random numbers")


_NO_RANDOMNESS = _NoRandomness()


def is_random(value: Any) -> bool:
    """Whether this draws random numbers."""
    return isinstance(value, np.random.RandomState | np.random.Generator)


def untouched(task: Any, seed: int) -> bool:
    """Whether a task that was made with a seed has not drawn from it yet."""
    fresh = np.random.RandomState(seed).get_state(legacy=False)
    states = [
        v.get_state(legacy=False)
        for v in vars(task).values()
        if isinstance(v, np.random.RandomState)
    ]
    return bool(states) and all(same(state, fresh) for state in states)


def copies(task: Any, seed: int, count: int) -> list[Any]:
    """The task for each world, with random numbers of its own: those of `seed` + its number."""
    tasks = Tasks([copy.deepcopy(task) for _ in range(count)])
    for world in range(count):
        tasks.seed(world, seed + world)
    return tasks.each


class Tasks:
    """One task for each world.

    Attributes:
      each: the tasks.
      changes: grows whenever one may have changed.
    """

    def __init__(self, each: Sequence[Any]) -> None:
        self.each, self.changes = list(each), 0
        self._shared = {k: v for k, v in vars(self.each[0]).items() if not is_random(v)}
        self._varied: dict[str, _Attribute] = {}
        for world in range(len(self.each)):
            self.note(world)

    def seed(self, world: int, seed: int) -> None:
        """Gives a world's task the random numbers of a seed."""
        task = self.each[world]
        for name, value in vars(task).items():
            if isinstance(value, np.random.RandomState):
                setattr(task, name, np.random.RandomState(seed % 2**32))
            elif is_random(value):
                setattr(task, name, np.random.default_rng(seed))

    def note(self, world: int) -> None:
        """Takes over what an episode's beginning has set in a world's task."""
        self.changes += 1
        mine = vars(self.each[world])
        if mine.keys() - {k for k, v in mine.items() if is_random(v)} != self._known():
            for name in mine:
                if name not in self._known() and not is_random(mine[name]):
                    self._varied[name] = _Attribute(name, self.each)
        for name, value in list(self._shared.items()):
            if not same(mine.get(name), value):
                self._varied[name] = _Attribute(name, self.each)
                del self._shared[name]
        for name, attribute in self._varied.items():
            attribute.set(world, mine.get(name))

    def together(self, ids: Ids | None) -> Any:
        """A task for some worlds (None: all); what differs between them is `Worlds`.

        Raises:
          NotBatchedError: something differs that is not made of numbers.
        """
        task = copy.copy(self.each[0])
        for name, value in vars(task).items():
            if is_random(value):
                setattr(task, name, _NO_RANDOMNESS)
        for name, attribute in self._varied.items():
            setattr(task, name, attribute.together(ids))
        return task

    def _known(self) -> set[str]:
        return {*self._shared, *self._varied}


class _Attribute:
    """An attribute that may differ from world to world.

    Numbers of one type and shape are kept as the rows of an array, too: each step asks for them
    three times, and a loop over thousands of worlds takes milliseconds.

    Args:
      name: of the attribute. tasks: of all worlds.
    """

    def __init__(self, name: str, tasks: Sequence[Any]) -> None:
        self._name = name
        self._values = [vars(task).get(name) for task in tasks]
        self._rows: npt.NDArray[Any] | None = None
        self._stale = True

    def set(self, world: int, value: Any) -> None:
        """Takes what it is in one world now."""
        self._values[world] = value
        if self._rows is None or _kind(value) != self._kind:
            self._stale = True
            return
        try:
            self._rows[world] = value
        except OverflowError:  # Python's integers have no limit
            self._stale = True

    def together(self, ids: Ids | None) -> Any:
        """Its value where it is the same in some worlds (None: all), otherwise `Worlds`.

        Raises:
          NotBatchedError: it differs and is not made of numbers.
        """
        if self._stale:
            self._rows, self._kind = _stacked(self._values)
            self._stale = False
        first = self._values[0 if ids is None else ids[0]]
        if self._rows is not None:
            rows = self._rows.copy() if ids is None else self._rows[ids]
            repeated = np.broadcast_to(rows[0], rows.shape)
            if np.array_equal(rows, repeated, equal_nan=rows.ndim > 1 and rows.dtype.kind == "f"):
                return first
        else:
            chosen = self._values if ids is None else [self._values[i] for i in ids]
            if all(same(value, first) for value in chosen):
                return first
            rows = self._of_numbers(chosen)
        rows.flags.writeable = False
        return Worlds(rows)

    def _of_numbers(self, values: Sequence[Any]) -> npt.NDArray[Any]:
        try:
            rows = np.stack([np.asarray(value) for value in values])
        except ValueError:
            rows = np.empty(0, object)
        if rows.dtype.kind not in "biuf":
            raise NotBatchedError(f"the task's {self._name!r} is of another kind in every world")
        return rows


def _kind(value: Any) -> tuple[Any, ...]:
    """Type, and shape where it has one."""
    return (type(value), getattr(value, "dtype", None), getattr(value, "shape", None))


def _stacked(values: Sequence[Any]) -> tuple[npt.NDArray[Any] | None, tuple[Any, ...]]:
    """The rows of numbers of one kind, and that kind; None of anything else."""
    kind = _kind(values[0])
    numbers = kind[0] in (bool, int, float) or isinstance(values[0], np.ndarray | np.generic)
    if not numbers or any(_kind(value) != kind for value in values):
        return None, kind
    rows = np.stack([np.asarray(value) for value in values])
    as_it_is = rows.dtype.kind in "biuf" and rows.dtype == np.asarray(values[0]).dtype
    return (rows if as_it_is else None), kind


def same(a: Any, b: Any) -> bool:
    """Whether two values of attributes are equal; objects without equality are if they are one."""
    if a is b:
        return True
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        kinds = isinstance(a, np.ndarray) and isinstance(b, np.ndarray)
        return kinds and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if type(a) is not type(b):
        return False
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(v, b[k]) for k, v in a.items())
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    try:
        return bool(a == b)
    except (TypeError, ValueError):
        return False
