"""Windows of recordings on the grid of a backend's steps, and the positions to be reached."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.errors import RecordingError
from orbisim.freerun import Prepared
from orbisim.recording import initial
from orbisim.recording.zero_order_hold import Held

Floats = npt.NDArray[np.float64]

PLACE, TURN, JOINT = 0.002, 0.02, 0.01
"""m, rad, rad or m: units of errors of free bodies and of joints. Errors of a model are of this
size; where they are smaller or larger throughout, intervals follow (see `estimate`)."""


@dataclasses.dataclass(frozen=True, eq=False)
class Grid:
    """W windows of T steps.

    Attributes:
      qpos, qvel, act: [W, ...] where they begin. ctrl: [W, T, nu].
      target: [W, T, nq] recorded positions after each step; NaN where there are none.
      recording: [W] numbers of the recordings.
    """

    qpos: Floats
    qvel: Floats
    act: Floats
    ctrl: Floats
    target: Floats
    recording: npt.NDArray[np.int64]


def grid(prepared: Sequence[Prepared], step: float) -> Grid:
    """All windows of recordings; recorded positions are interpolated between samples.

    Args:
      prepared: see `replay.prepare`. step: of the backend, s.

    Raises:
      RecordingError: recorded forces drive joints, or a window is shorter than one step.
    """
    parts: list[tuple[Floats, ...]] = []
    count = _steps(prepared, step)
    for number, one in enumerate(prepared):
        bound = one.bound
        if bound.applied.any():
            raise RecordingError(
                bound.recording.source,
                "recorded joint forces drive the scene",
                remedy="record the controls of actuators instead",
            )
        held = Held(bound.time, bound.ctrl)
        for rows in one.windows:
            start = float(bound.time[rows.start])
            when = np.asarray(start + step * np.arange(1, count + 1), np.float64)
            row = np.array([rows.start])
            parts.append(
                (
                    one.states.qpos[rows.start],
                    one.states.qvel[rows.start],
                    initial.activations(bound, one.states, row)[0],
                    held.means(start, step, 0, count),
                    between(bound.time, bound.qpos, when, float(bound.time[rows.stop - 1])),
                    np.array(number),
                )
            )
    columns = [np.stack(column) for column in zip(*parts, strict=True)]
    return Grid(*columns)


def _steps(prepared: Sequence[Prepared], step: float) -> int:
    spans = [
        one.bound.time[rows.stop - 1] - one.bound.time[rows.start]
        for one in prepared
        for rows in one.windows
    ]
    count = int(np.floor(max(spans) / step + 1e-6))
    if count < 1:
        raise RecordingError(
            prepared[0].bound.recording.source,
            f"windows last {max(spans):.4g} s, less than a step of the backend, {step:.4g} s",
            remedy="give a longer --window",
        )
    return count


def between(time: Floats, values: Floats, when: Floats, end: float) -> Floats:
    """Values [N, n] at times, linear between samples; NaN after the end and next to a NaN."""
    high = np.clip(np.searchsorted(time, when - 1e-9), 1, len(time) - 1)
    part = ((when - time[high - 1]) / (time[high] - time[high - 1]))[:, None]
    near = np.where(part > 1 - 1e-6, values[high], values[high - 1] * (1 - part))
    found = np.where(part > 1 - 1e-6, near, near + values[high] * part)
    found[when > end + 1e-9] = np.nan
    return np.asarray(found)


def places(model: mujoco.MjModel) -> tuple[list[int], list[int]]:
    """Addresses in qpos of hinge and slide joints, and of free joints."""
    free = int(mujoco.mjtJoint.mjJNT_FREE)
    scalar = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    kinds = model.jnt_type
    joints = [int(model.jnt_qposadr[j]) for j in range(model.njnt) if kinds[j] in scalar]
    bodies = [int(model.jnt_qposadr[j]) for j in range(model.njnt) if kinds[j] == free]
    return joints, bodies
