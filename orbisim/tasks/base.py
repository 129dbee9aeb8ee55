"""`Task`: what a task must offer."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from orbisim.episodes import Episodes, Floats
from orbisim.errors import InputError, UnknownNameError
from orbisim.scene import Scene
from orbisim.tasks.episode import Episode
from orbisim.tasks.sampling import override


@dataclasses.dataclass(frozen=True)
class NoConfig:
    """The configuration of a task that has nothing to set."""


class Task(abc.ABC):
    """A distribution of scenes with policies that act in them.

    Args:
      **changes: fields of the task's configuration to replace.

    Attributes:
      name: under which it is registered, without `task:`.
      counts: how many episodes the paper has of each subtask.
      default_subtask: the one that `compare` uses.
      control_timestep: duration of a control step, s.
      horizon: duration of an episode, s.
    """

    name: ClassVar[str]
    counts: ClassVar[Mapping[str, int]]
    default_subtask: str
    control_timestep: float
    horizon: float
    config: Any = NoConfig()

    def __init__(self, **changes: Any) -> None:
        if changes:
            self.config = override(type(self).config, changes)

    @property
    def subtasks(self) -> Mapping[str, int]:
        """How many episodes the paper has of each subtask."""
        return self.counts

    @property
    def timestep(self) -> float:
        """The scene's own timestep, s."""
        return float(self.scene().model.opt.timestep)

    @property
    def label(self) -> str:
        """The name as `load_scene` and `orbisim collect` take it."""
        return f"task:{self.name}"

    @property
    def identity(self) -> str:
        """Of what the name may stand for at another time: of the content of a file."""
        return ""

    @abc.abstractmethod
    def scene(self, subtask: str | None = None, seed: int | None = None) -> Scene:
        """A scene drawn from the distribution; the nominal one without a seed."""

    @abc.abstractmethod
    def episode(self, subtask: str, seed: int) -> Episode:
        """One episode; the same arguments give the same bytes."""

    @abc.abstractmethod
    def trials(self, count: int, seed: int, subtask: str | None = None) -> Episodes:
        """Episodes on one scene of the distribution, with the policy's controls, for A/B runs."""

    def check_subtask(self, subtask: str | None) -> str:
        """The subtask, or the default one.

        Raises:
          UnknownNameError: there is no such subtask.
        """
        if subtask is None:
            return self.default_subtask
        if subtask not in self.subtasks:
            raise UnknownNameError(f"subtask of {self.label}", subtask, self.subtasks)
        return subtask

    def allotment(self, episodes: int | None, subtask: str | None = None) -> list[tuple[str, int]]:
        """Which episodes make up a collection: (subtask, number within the subtask) of each.

        Args:
          episodes: how many; all of the paper's if None. Subtasks get shares as in the paper.
          subtask: only this one.

        Raises:
          InputError: not at least one episode.
        """
        if episodes is not None and episodes < 1:
            raise InputError(f"need at least one episode; got {episodes}")
        counts = dict(self.subtasks)
        if subtask is not None:
            name = self.check_subtask(subtask)
            counts = {name: episodes or counts[name]}
        elif episodes is not None:
            counts = dict(zip(counts, shares(list(counts.values()), episodes), strict=True))
        return [(name, index) for name, count in counts.items() for index in range(count)]


def shares(weights: Sequence[int], total: int) -> list[int]:
    """`total` split in proportion to the weights, by largest remainders."""
    whole = sum(weights)
    parts = [total * weight // whole for weight in weights]
    order = sorted(range(len(weights)), key=lambda i: (-(total * weights[i] % whole), i))
    for i in order[: total - sum(parts)]:
        parts[i] += 1
    return parts


@dataclasses.dataclass(frozen=True)
class Scripted(Episodes):
    """Episodes with given controls.

    Attributes:
      sequence: [nworld, T, nu], each held for `held` seconds; the last one goes on.
      held: s.
    """

    sequence: Floats
    held: float

    @property
    def horizon(self) -> float:
        """Until the last control has been held, s."""
        return self.sequence.shape[1] * self.held

    def controls(self, duration: float, step: float, seed: int) -> Floats:
        """The controls, resampled to `step` seconds; [nworld, T, nu]."""
        import numpy as np

        steps = max(1, round(duration / step))
        last = self.sequence.shape[1] - 1
        index = np.minimum((np.arange(steps) * step / self.held + 1e-9).astype(int), last)
        return self.sequence[:, index]
