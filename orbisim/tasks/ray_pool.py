"""Work spread over the machines of a Ray cluster."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from orbisim.errors import MissingDependencyError


def run(
    order: Any, chunks: Sequence[list[int]], paths: Sequence[Path], workers: int
) -> Iterator[None]:
    """Makes chunks of episodes on the cluster; yields once for each that is done.

    The cluster is the one that this process is connected to, the one at RAY_ADDRESS, or a new one
    on this machine with `workers` workers. Results come back over Ray's object store, so that no
    file system need be shared.

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
        yield from _spread(ray, order, chunks, paths, workers)
    finally:
        if ours:
            ray.shutdown()


def _spread(
    ray: Any, order: Any, chunks: Sequence[list[int]], paths: Sequence[Path], workers: int
) -> Iterator[None]:
    remote = ray.remote(num_cpus=1)(chunk_bytes)
    shared = ray.put(order)
    waiting = list(zip(chunks, paths, strict=True))[::-1]
    running: dict[Any, Path] = {}
    while waiting or running:
        while waiting and len(running) < max(workers, int(ray.cluster_resources().get("CPU", 1))):
            chunk, path = waiting.pop()
            running[remote.remote(shared, chunk)] = path
        done, _ = ray.wait(list(running))
        for reference in done:
            path = running.pop(reference)
            partial = path.with_suffix(".tmp")
            partial.write_bytes(ray.get(reference))
            partial.replace(path)
            yield None


def chunk_bytes(order: Any, numbers: Sequence[int]) -> bytes:
    """A chunk as the bytes of its file."""
    from orbisim.tasks.orders import make_chunk

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chunk.h5"
        make_chunk(order, numbers, path)
        return path.read_bytes()
