# mypy: ignore-errors
# Warp kernels are compiled from their source; their annotations are not types.
"""Kernels that move controls and records between rollout buffers and the simulation."""

from __future__ import annotations

import warp as wp


@wp.kernel(enable_backward=False)
def load_control(
    cursor: wp.array(dtype=int),
    hold: int,
    controls: wp.array(dtype=float, ndim=3),
    ctrl: wp.array(dtype=float, ndim=2),
) -> None:
    """ctrl[world, i] = controls[world, cursor // hold, i]."""
    world, i = wp.tid()
    ctrl[world, i] = controls[world, cursor[0] // hold, i]


@wp.kernel(enable_backward=False)
def record(
    cursor: wp.array(dtype=int),
    hold: int,
    values: wp.array(dtype=float, ndim=2),
    records: wp.array(dtype=float, ndim=3),
) -> None:
    """records[world, cursor // hold, i] = values[world, i]."""
    world, i = wp.tid()
    records[world, cursor[0] // hold, i] = values[world, i]


@wp.kernel(enable_backward=False)
def advance(cursor: wp.array(dtype=int)) -> None:
    """Moves on to the next step."""
    cursor[0] = cursor[0] + 1
