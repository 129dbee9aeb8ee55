"""Free-running simulation of windows of recordings, many at once, on any backend."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np

from orbisim.backend import Backend, Capability
from orbisim.errors import InputError
from orbisim.freerun.batch import Batch
from orbisim.freerun.jobs import Job, Prepared, Run
from orbisim.host.progress import track
from orbisim.recording.zero_order_hold import Held, filled
from orbisim.scene import Scene

WORLDS = 256
"""Windows that are simulated at once."""


def free_run(backend: Backend, scene: Scene, prepared: Sequence[Prepared]) -> list[Run]:
    """Simulates every window from its recorded state to its end.

    The scene's timestep is the backend's own; a control is averaged over each step (exact where a
    step lies between two samples). States at recorded times between two steps are interpolated on
    the manifold: cubic in positions, linear in velocities, activations and sensors.

    Returns:
      One run for each window, in order.

    Raises:
      InputError: a recorded force drives a joint and the backend integrates no equations of motion.
    """
    runs: dict[tuple[int, int], Run] = {}
    for switched_off, jobs in _by_drive(prepared).items():
        _load(backend, _without_actuators(scene, switched_off))
        if any(job.force for job in jobs) and Capability.CLASSICAL not in backend.capabilities:
            raise InputError(
                f"backend {backend.name!r} does not take recorded joint forces; record the "
                "controls of actuators instead"
            )
        jobs.sort(key=lambda job: job.duration)
        groups = [jobs[i : i + WORLDS] for i in range(0, len(jobs), WORLDS)]
        for group in track(groups, f"replay on {backend.name}"):
            for run in Batch(backend, group).run():
                runs[run.recording, run.rows.start] = run
    _load(backend, scene)
    return [runs[i, rows.start] for i, one in enumerate(prepared) for rows in one.windows]


def _load(backend: Backend, scene: Scene) -> None:
    """Loads the scene unless it is loaded already."""
    try:
        if backend.scene is scene:
            return
    except InputError:  # it has none
        pass
    backend.load(scene)


def _by_drive(prepared: Sequence[Prepared]) -> dict[tuple[int, ...], list[Job]]:
    """The windows, by the actuators that are switched off in them."""
    found: dict[tuple[int, ...], list[Job]] = {}
    for number, one in enumerate(prepared):
        bound = one.bound
        force = None
        if bound.applied.any():
            values = np.where(bound.applied, np.nan_to_num(filled(bound.torque)), 0.0)
            force = Held(bound.time, values)
        ctrl = Held(bound.time, bound.ctrl)
        jobs = [Job(number, rows, one, ctrl, force) for rows in one.windows]
        found.setdefault(bound.switched_off, []).extend(jobs)
    return found


def _without_actuators(scene: Scene, switched_off: tuple[int, ...]) -> Scene:
    """The scene with some actuators exerting no force."""
    if not switched_off:
        return scene
    model = copy.copy(scene.model)
    chosen = list(switched_off)
    model.actuator_gaintype[chosen] = int(mujoco.mjtGain.mjGAIN_FIXED)
    model.actuator_biastype[chosen] = int(mujoco.mjtBias.mjBIAS_NONE)
    for name in ("gainprm", "biasprm", "damping", "dampingpoly"):
        getattr(model, f"actuator_{name}")[chosen] = 0.0
    return scene.with_model(model)
