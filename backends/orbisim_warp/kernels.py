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


@wp.kernel(enable_backward=False)
def copy_columns(
    columns: wp.array(dtype=int),
    source: wp.array(dtype=float, ndim=2),
    target: wp.array(dtype=float, ndim=2),
) -> None:
    """target[world, columns[i]] = source[world, columns[i]]."""
    world, i = wp.tid()
    target[world, columns[i]] = source[world, columns[i]]


@wp.func
def _bad(value: float, limit: float) -> bool:
    """C MuJoCo's test: NaN, or larger than mjMAXVAL in size."""
    return not wp.abs(value) <= limit


@wp.kernel(enable_backward=False)
def note_divergence(
    cursor: wp.array(dtype=int),
    limit: float,
    qpos: wp.array(dtype=float, ndim=2),
    qvel: wp.array(dtype=float, ndim=2),
    qacc: wp.array(dtype=float, ndim=2),
    act: wp.array(dtype=float, ndim=2),
    ctrl: wp.array(dtype=float, ndim=2),
    lost: wp.array(dtype=int),
) -> None:
    """lost[world] = cursor, once a number of the world is one that C MuJoCo would refuse."""
    world = wp.tid()
    bad = bool(False)  # noqa: UP018 (to Warp a variable; a literal is a constant)
    for i in range(qpos.shape[1]):
        bad = bad or _bad(qpos[world, i], limit)
    for i in range(qvel.shape[1]):
        bad = bad or _bad(qvel[world, i], limit) or _bad(qacc[world, i], limit)
    for i in range(act.shape[1]):
        bad = bad or not wp.isfinite(act[world, i])
    for i in range(ctrl.shape[1]):
        bad = bad or _bad(ctrl[world, i], limit)
    if bad and lost[world] < 0:
        lost[world] = cursor[0]


@wp.kernel(enable_backward=False)
def note_negative_inertia(
    cursor: wp.array(dtype=int),
    tolerance: float,
    before: wp.array(dtype=float, ndim=2),
    after: wp.array(dtype=float, ndim=2),
    force: wp.array(dtype=float, ndim=2),
    lost: wp.array(dtype=int),
) -> None:
    """lost[world] = cursor, once forces decelerate what they push.

    An implicit step solves (M - h D) dv = h f. Its matrix is positive definite only if f dv > 0
    for every f. Where it is not, C MuJoCo's factorization breaks down and the state diverges;
    MuJoCo-Warp's goes on with a velocity of the wrong sign.
    """
    world = wp.tid()
    power = float(0.0)  # noqa: UP018
    size = float(0.0)  # noqa: UP018
    for i in range(after.shape[1]):
        part = force[world, i] * (after[world, i] - before[world, i])
        power += part
        size += wp.abs(part)
    if power < -tolerance * size and lost[world] < 0:
        lost[world] = cursor[0]
