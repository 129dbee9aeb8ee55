"""Work spread over processes of this machine."""

from __future__ import annotations

import concurrent.futures
import multiprocessing
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from orbisim.errors import OrbiSimError
from orbisim.host.children import begin_work

_NOT_FORKED = {"torch", "OpenGL.EGL"}
"""Modules that a forked process cannot go on with: torch's threads may hang there, and NVIDIA's
driver makes no context on an EGL display that was opened before the fork (EGL_BAD_ALLOC)."""


def run(work: Callable[..., None], jobs: Sequence[tuple[Any, ...]], workers: int) -> Iterator[None]:
    """Runs `work(*job)` for every job; yields once for each that is done, in any order.

    The processes end with this one, and when the work is interrupted or fails.

    Raises:
      OrbiSimError: a process was killed (for memory, say); whatever a job raises.
    """
    context = multiprocessing.get_context("spawn" if _NOT_FORKED & sys.modules.keys() else "fork")
    others = set(multiprocessing.active_children())
    with concurrent.futures.ProcessPoolExecutor(workers, context, begin_work) as pool:
        futures = [pool.submit(work, *job) for job in jobs]
        try:
            for future in concurrent.futures.as_completed(futures):
                future.result()
                yield None
        except concurrent.futures.process.BrokenProcessPool as error:
            raise OrbiSimError(
                "a worker process was killed (out of memory?); what is done is kept, run the same "
                "command again, with fewer workers"
            ) from error
        except BaseException:  # what runs is not waited for, what waits is not begun
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            raise
