"""Work spread over the machines of a Ray cluster."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from orbisim.errors import MissingDependencyError
from orbisim.files.temporary import temporary_folder
from orbisim.files.writing import output_errors
from orbisim.tasks.chunks import keep
from orbisim.tasks.orders import Order, write_episodes


def run(order: Order, missing: Sequence[list[int]], folder: Path, workers: int) -> Iterator[None]:
    """Makes chunks of episodes on the cluster; yields once for each that is in the folder.

    The cluster is the one that this process is connected to, the one at RAY_ADDRESS, or a new one
    on this machine with `workers` workers. Results come back over Ray's object store, so that no
    file system need be shared.

    Raises:
      MissingDependencyError: Ray is not installed.
    """
    with cluster(workers) as ray:
        yield from _spread(ray, order, missing, folder, workers)


@contextlib.contextmanager
def cluster(workers: int) -> Iterator[Any]:
    """The module `ray`, connected to a cluster; leaves it in the end if it was not before.

    Args:
      workers: of a new cluster on this machine, if there is none.

    Raises:
      MissingDependencyError: Ray is not installed.
    """
    try:
        import ray
    except ImportError as error:
        raise MissingDependencyError("--ray", "ray", "no module 'ray'") from error

    ours = not ray.is_initialized()
    if ours:
        known = os.environ.get("RAY_ADDRESS")
        options: dict[str, Any] = {} if known else {"num_cpus": workers, "include_dashboard": False}
        ray.init(log_to_driver=False, logging_level="error", **options)
    try:
        yield ray
    finally:
        if ours:
            ray.shutdown()


def _spread(
    ray: Any, order: Order, missing: Sequence[list[int]], folder: Path, workers: int
) -> Iterator[None]:
    remote = ray.remote(num_cpus=1)(chunk_bytes)
    shared = ray.put(order)
    waiting = list(missing)[::-1]
    running: dict[Any, list[int]] = {}
    while waiting or running:
        while waiting and len(running) < max(workers, int(ray.cluster_resources().get("CPU", 1))):
            chunk = waiting.pop()
            running[remote.remote(shared, chunk)] = chunk
        done, _ = ray.wait(list(running))
        for reference in done:
            chunk, content = running.pop(reference), ray.get(reference)
            with output_errors(folder), temporary_folder(folder, ".chunk-") as scratch:
                part = scratch / "chunk.h5"
                part.write_bytes(content)
                keep(part, chunk, folder)
            yield None


def chunk_bytes(order: Order, numbers: Sequence[int]) -> bytes:
    """A chunk as the bytes of its file."""
    with temporary_folder() as folder:
        path = folder / "chunk.h5"
        write_episodes(order, numbers, path)
        return path.read_bytes()
