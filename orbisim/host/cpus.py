"""How many processors there are to use."""

from __future__ import annotations

import os

import mujoco


def usable_cpus() -> int:
    """Processors that this process may run on; all there are where that cannot be told."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def threads_for(model: mujoco.MjModel, worlds: int, steps: int) -> int:
    """Threads that step so many worlds at once. Few worlds of few joints are stepped sooner by one
    thread than by several that wait for each other.

    Args:
      steps: timesteps in one call, after which threads wait for each other.
    """
    each = _RK4_STAGES if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4 else 1
    work = worlds * int(model.nv) * steps * each
    return max(1, min(work // _WORTH_A_THREAD, worlds, usable_cpus()))


_RK4_STAGES = 4
"""How often RK4 evaluates the dynamics in a timestep; MuJoCo's other integrators do once."""
_WORTH_A_THREAD = 50
"""Worlds times degrees of freedom times evaluations that keep a thread busy: some 40 us. To wake a
second thread takes as long as to step 24 worlds of two joints once by one."""
