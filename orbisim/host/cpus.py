"""How many processors there are to use."""

from __future__ import annotations

import os


def usable_cpus() -> int:
    """Processors that this process may run on; all there are where that cannot be told."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def threads_for(worlds: int, work: int) -> int:
    """Threads that step so many worlds at once. Few worlds of few joints are stepped sooner by one
    thread than by several that wait for each other.

    Args:
      work: worlds times degrees of freedom times timesteps.
    """
    return max(1, min(work // _WORTH_A_THREAD, worlds, usable_cpus()))


_WORTH_A_THREAD = 200
"""Worlds times degrees of freedom times timesteps that keep a thread busy."""
