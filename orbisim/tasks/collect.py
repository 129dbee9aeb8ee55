"""Collects episodes on all cores, or on a Ray cluster, into one file.

Episodes are made in chunks. Each chunk is a file of its own in a folder beside the destination; it
appears only when it is whole, and is kept when the work is interrupted. The same command goes on
from there. When all chunks exist they are joined. The bytes of the result depend on neither the
number of workers nor the interruptions.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from orbisim.errors import InputError, OrbiSimError
from orbisim.files.locking import claimed
from orbisim.files.writing import make_folder
from orbisim.host.cpus import usable_cpus
from orbisim.host.progress import track
from orbisim.tasks import chunks, pool, ray_pool, storage
from orbisim.tasks.base import Task
from orbisim.tasks.dataset import EpisodeFile, vouch_for
from orbisim.tasks.frames import Camera, check_camera
from orbisim.tasks.orders import Order
from orbisim.tasks.registry import make


@dataclasses.dataclass(frozen=True)
class Collection:
    """What was collected.

    Attributes:
      path: the file. episodes, steps: how many.
      subtasks: episodes of each subtask. success: share of successes, where there is a measure.
      seconds: wall-clock time of this run. resumed: episodes that an earlier run had made.
    """

    path: Path
    episodes: int
    steps: int
    subtasks: Mapping[str, int]
    success: Mapping[str, float]
    seconds: float
    resumed: int

    def to_json(self) -> dict[str, Any]:
        """As plain values."""
        return {**dataclasses.asdict(self), "path": str(self.path)}


def collect(
    task: str,
    path: str | Path,
    *,
    episodes: int | None = None,
    seed: int = 0,
    workers: int | None = None,
    subtask: str | None = None,
    camera: Camera | None = None,
    changes: Mapping[str, Any] | None = None,
    ray: bool = False,
) -> Collection:
    """Collects episodes of a task into a file.

    Args:
      task: name as `make` takes it, or the path of a scene.
      path: the file, which must not exist.
      episodes: how many; the paper's counts if None.
      seed: of the collection; every episode has its own, derived from it.
      workers: processes, or Ray tasks at a time; all cores if None.
      subtask: only this one; all in the paper's proportions if None.
      camera: whose images to record.
      changes: to the task's configuration.
      ray: spread over the Ray cluster that this process is connected to (or starts).

    Raises:
      UnknownNameError: there is no such task, subtask, camera or setting.
      InputError: numbers or path do not make sense, or an unfinished collection of something else
        is in the way.
      MissingDependencyError: h5py or Ray is not installed.
    """
    started = time.monotonic()
    path = Path(path)
    made = make(task, **(changes or {}))
    entries = tuple(made.allotment(episodes, subtask))
    if not entries:
        raise InputError(f"the paper has no episodes of {subtask!r}; say how many")
    count = _workers(workers)
    if seed < 0:
        raise InputError(f"a seed is at least 0; got {seed}")
    storage.check_destination(path)
    if camera is not None:
        check_camera(made.scene(), camera)
    order = Order(made.label, dict(changes or {}), seed, camera, entries, made.identity)
    folder = path.with_name(path.name + ".partial")
    with claimed(make_folder(folder), "another collection", "wait for it, or choose another name"):
        missing = _make_missing(order, folder, _with_ray if ray else _with_processes, count)
        parts = [_whole(folder, chunk) for chunk in order.chunks()]
        storage.assemble(path, parts, _attributes(made, order))
        shutil.rmtree(folder)
    return _summary(path, time.monotonic() - started, len(entries) - missing)


Spread = Callable[[Order, Path, Sequence[range], int], Iterable[None]]


def _make_missing(order: Order, folder: Path, spread: Spread, workers: int) -> int:
    """Makes the chunks that are not there yet; returns how many episodes that were."""
    chunks.prepare(folder, order)
    missing = [chunk for chunk in order.chunks() if chunks.finished(folder, chunk) is None]
    made = spread(order, folder, missing, workers)
    for _ in track(made, f"collecting {order.task}", len(missing)):
        pass
    return sum(map(len, missing))


def _whole(folder: Path, chunk: range) -> Path:
    path = chunks.finished(folder, chunk)
    if path is None:
        raise OrbiSimError(f"{folder}: a chunk was lost while it was written; run it again")
    return path


def _workers(workers: int | None) -> int:
    if workers is not None and workers < 1:
        raise InputError(f"need at least one worker; got {workers}")
    return workers or usable_cpus()


def _attributes(task: Task, order: Order) -> dict[str, Any]:
    config = dataclasses.asdict(task.config)
    return {
        "task": order.task,
        "seed": order.seed,
        "control_timestep": task.control_timestep,
        "timestep": task.timestep,
        "config": json.dumps(config, sort_keys=True),
        "versions": json.dumps(storage.versions(), sort_keys=True),
    }


def _with_processes(
    order: Order, folder: Path, missing: Sequence[range], workers: int
) -> Iterator[None]:
    if workers == 1 or len(missing) < 2:
        for chunk in missing:
            chunks.make_chunk(order, chunk, folder)
            yield
        return
    jobs = [(order, list(chunk), folder) for chunk in missing]
    yield from pool.run(chunks.make_chunk, jobs, min(workers, len(jobs)))


def _with_ray(order: Order, folder: Path, missing: Sequence[range], workers: int) -> Iterator[None]:
    yield from ray_pool.run(order, [list(chunk) for chunk in missing], folder, workers)


def _summary(path: Path, seconds: float, resumed: int) -> Collection:
    subtasks: dict[str, int] = {}
    successes: dict[str, list[bool]] = {}
    vouch_for(path)
    with EpisodeFile(path) as file:
        steps = sum(file.lengths())
        for index in range(len(file)):
            attributes = file.attributes(index)
            name = attributes["subtask"]
            subtasks[name] = subtasks.get(name, 0) + 1
            if attributes["success"] is not None:
                successes.setdefault(name, []).append(attributes["success"])
        count = len(file)
    rates = {name: sum(values) / len(values) for name, values in successes.items()}
    return Collection(path, count, steps, subtasks, rates, round(seconds, 2), resumed)
