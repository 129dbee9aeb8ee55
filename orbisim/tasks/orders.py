"""What to collect, and the making of a part of it."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from orbisim.errors import DivergedError, OrbiSimError
from orbisim.tasks import storage
from orbisim.tasks.base import Task
from orbisim.tasks.episode import Episode
from orbisim.tasks.frames import Camera, with_frames
from orbisim.tasks.registry import make
from orbisim.tasks.sampling import episode_seed

_CHUNK = 16
"""Episodes that a process makes before it writes: little is lost when it is killed."""
_SEEN_CHUNK = 2
"""The same with images: an episode takes seconds, and processes should end together."""
_ATTEMPTS = 5
"""Draws of an episode whose simulation is unstable; five in a row mean that the task is."""


@dataclasses.dataclass(frozen=True)
class Order:
    """What to collect.

    Attributes:
      task: name as `make` takes it. changes: to its configuration.
      seed: of the collection. camera: whose images to record, if any.
      entries: (subtask, number within the subtask) of each episode.
      identity: of what the name stands for.
    """

    task: str
    changes: Mapping[str, Any]
    seed: int
    camera: Camera | None
    entries: tuple[tuple[str, int], ...]
    identity: str = ""

    @property
    def key(self) -> str:
        """The same for equal orders under equal versions."""
        content = [dataclasses.asdict(self), storage.versions()]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def chunks(self) -> list[range]:
        """Numbers of the episodes in each chunk."""
        count, size = len(self.entries), _CHUNK if self.camera is None else _SEEN_CHUNK
        return [range(i, min(i + size, count)) for i in range(0, count, size)]


def write_episodes(order: Order, numbers: Sequence[int], path: Path) -> None:
    """Makes the episodes of those numbers and writes them to a file."""
    task = make(order.task, **order.changes)

    def produce() -> Iterator[tuple[int, Any]]:
        for number in numbers:
            episode = _episode(task, order, *order.entries[number])
            if order.camera is not None:
                scene = task.scene(episode.subtask, episode.seed)
                episode = with_frames(episode, scene, order.camera)
            yield number, episode

    storage.write_episodes(path, produce())


def _episode(task: Task, order: Order, subtask: str, index: int) -> Episode:
    """An episode of the collection; one whose simulation is unstable is drawn again."""
    for attempt in range(_ATTEMPTS):
        label = subtask if attempt == 0 else f"{subtask}#{attempt}"
        seed = episode_seed(order.seed, order.task, label, index)
        try:
            return task.episode(subtask, seed)
        except DivergedError as error:
            last = error
    raise OrbiSimError(f"{order.task}, {subtask}, episode {index}: {last}, {_ATTEMPTS} times over")
