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

from orbisim.cpus import usable_cpus
from orbisim.errors import InputError
from orbisim.progress import track
from orbisim.tasks import storage
from orbisim.tasks.base import Task
from orbisim.tasks.frames import Camera, check_camera
from orbisim.tasks.orders import Order, make_chunk
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
      task: name as `make` takes it.
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
    order = Order(made.label, dict(changes or {}), seed, camera, entries)
    folder = _folder(path, order)
    missing = [chunk for chunk in order.chunks() if not _chunk_path(folder, chunk).exists()]
    spread = _with_ray if ray else _with_processes
    for _ in track(spread(order, folder, missing, count), f"collecting {made.label}", len(missing)):
        pass
    chunks = [_chunk_path(folder, chunk) for chunk in order.chunks()]
    storage.assemble(path, chunks, _attributes(made, order))
    shutil.rmtree(folder)
    resumed = len(entries) - sum(map(len, missing))
    return _summary(path, time.monotonic() - started, resumed)


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


def _folder(path: Path, order: Order) -> Path:
    """The folder of the chunks, new or left by an earlier run of the same order."""
    folder = path.with_name(path.name + ".partial")
    folder.mkdir(exist_ok=True)
    label = folder / "order"
    if not label.exists():
        if any(folder.iterdir()):
            raise InputError(f"{folder}: is not an unfinished collection; move it out of the way")
        label.write_text(order.key)
    elif label.read_text() != order.key:
        raise InputError(
            f"{folder}: holds an unfinished collection of something else; finish it by the same "
            "command as before, or remove it"
        )
    return folder


def _chunk_path(folder: Path, chunk: range) -> Path:
    return folder / f"chunk-{chunk.start:06d}.h5"


Spread = Callable[[Order, Path, Sequence[range], int], Iterable[None]]


def _with_processes(
    order: Order, folder: Path, chunks: Sequence[range], workers: int
) -> Iterator[None]:
    if workers == 1 or len(chunks) < 2:
        for chunk in chunks:
            make_chunk(order, chunk, _chunk_path(folder, chunk))
            yield
        return
    from orbisim.tasks.pool import run

    jobs = [(order, list(chunk), _chunk_path(folder, chunk)) for chunk in chunks]
    yield from run(make_chunk, jobs, min(workers, len(jobs)))


def _with_ray(order: Order, folder: Path, chunks: Sequence[range], workers: int) -> Iterator[None]:
    from orbisim.tasks.ray_pool import run

    paths = [_chunk_path(folder, chunk) for chunk in chunks]
    yield from run(order, [list(chunk) for chunk in chunks], paths, workers)


def _summary(path: Path, seconds: float, resumed: int) -> Collection:
    from orbisim.tasks.dataset import EpisodeFile

    subtasks: dict[str, int] = {}
    successes: dict[str, list[bool]] = {}
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
