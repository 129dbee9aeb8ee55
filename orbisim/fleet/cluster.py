"""Robots spread over the machines of a Ray cluster; results come back over its object store."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from orbisim.files.temporary import temporary_folder
from orbisim.tasks.ray_pool import cluster

Attempt = Callable[..., str]
Result = tuple[Path, str, dict[str, bytes], str]


def spread(
    attempt: Attempt, scene: Any, tasks: Sequence[tuple[Any, Path, str, Any]], workers: int
) -> Iterator[Result]:
    """Runs `attempt(scene, recordings, folder, options)` for every task.

    The cluster is the one that this process is connected to, the one at RAY_ADDRESS, or a new one
    on this machine with `workers` workers.

    Args:
      tasks: (recordings, or what is wrong with them; place; mark; options) of each robot.

    Yields:
      Place, mark, files by their names, and what went wrong (empty if nothing), as they are done.

    Raises:
      MissingDependencyError: Ray is not installed.
    """
    with cluster(workers) as ray:
        yield from _spread(ray, attempt, scene, tasks)


def _spread(
    ray: Any, attempt: Attempt, scene: Any, tasks: Sequence[tuple[Any, Path, str, Any]]
) -> Iterator[Result]:
    remote, shared = ray.remote(num_cpus=1)(in_memory), ray.put(scene)
    running: dict[Any, tuple[Path, str]] = {}
    for recordings, place, mark, options in tasks:
        if isinstance(recordings, str):
            yield place, mark, {}, recordings
        else:
            running[remote.remote(attempt, shared, recordings, options)] = place, mark
    while running:
        done, _ = ray.wait(list(running))
        for reference in done:
            place, mark = running.pop(reference)
            try:
                files, problem = ray.get(reference)
            except Exception as error:  # of one robot: its machine is gone, or out of memory
                files, problem = {}, f"its worker failed: {type(error).__name__}"
            yield place, mark, files, problem


def in_memory(
    attempt: Attempt, scene: Any, recordings: Any, options: Any
) -> tuple[dict[str, bytes], str]:
    """What an attempt writes, as the contents of files, and what went wrong."""
    with temporary_folder() as folder:
        problem = attempt(scene, recordings, folder, options)
        files = [path for path in folder.rglob("*") if path.is_file()]
        return {str(path.relative_to(folder)): path.read_bytes() for path in files}, problem
