"""What one simulation says of an effect: the rest is corrected linearly.

A fit takes dozens of simulations. Where there are many suspects, one each ranks them: window
starts, the numbers that are fitted already, and the size of the effect are moved by derivatives.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from orbisim.shooting.fits import NOTHING, Hints, Unknown
from orbisim.shooting.gauss_newton import Problem, least_squares
from orbisim.shooting.shooter import Shooter, Variant

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]


@dataclasses.dataclass(frozen=True, eq=False)
class Own:
    """What the unknowns of a fit change.

    Attributes:
      slopes: [W, data, P] of the weighted data, for each unit. values: [P] where.
      simulated: [W, data] weighted, there. unknowns: with priors.
    """

    slopes: Floats
    values: Floats
    simulated: Floats
    unknowns: Sequence[Unknown]


def own_slopes(
    shooter: Shooter,
    build: Callable[[Floats], Variant],
    unknowns: Sequence[Unknown],
    start: Floats,
    hints: Hints = NOTHING,
) -> Own:
    """Derivatives of the weighted data by the unknowns where they begin, by differences.

    Args:
      start: [W, 2 nv] window starts. hints: derivatives that are known.
    """
    problem = Problem(shooter, build, unknowns, hints, None)
    values = np.clip(problem.begin, problem.low, problem.high)
    here = problem.trial(values, start)
    return Own(problem.slopes(here), values, shooter.scaled(here.simulated), unknowns)


def glanced(
    shooter: Shooter,
    variant: Variant,
    start: Floats,
    free: Floats,
    robust: float | None,
    own: Own | None = None,
    only: Bools | None = None,
) -> tuple[Floats, float]:
    """[W]: cost that one simulation leaves if starts are corrected linearly; and how large, in
    units of itself, that would best be in which `variant` differs (1 if `own` is None).

    Args:
      start: [W, 2 nv] where to start. free: [W, data, 2 nv] derivatives by the starts.
      own: what is corrected too: its unknowns, and how large that is in which `variant` differs.
      only: [W] the windows to look at, all if None; what is returned of others is meaningless.
    """
    if own is None:
        unknowns, values = [], np.zeros(0)
    else:
        unknowns, values = [*own.unknowns, _SIZE], np.append(own.values, 1.0)
    problem = Problem(shooter, lambda _: variant, unknowns, Hints(free), robust)
    here = problem.trial(values, problem.widened(values, start), only)
    slopes, residual = np.zeros((*here.residual.shape, 0)), here.residual
    if own is not None:
        change = shooter.scaled(here.simulated) - own.simulated
        slopes = np.concatenate([own.slopes, change[..., None]], axis=2)
    if only is not None:
        slopes = np.where(only[:, None, None], slopes, 0.0)
        residual = np.where(only[:, None], residual, 0.0)
    left, step = _corrected(problem, values, residual, slopes, free)
    return left, 1.0 if own is None else 1.0 + float(step[-1])


def moved_along(
    shooter: Shooter,
    variant: Variant,
    start: Floats,
    own: Own,
    hints: Hints,
    robust: float | None,
    step: Floats | None = None,
) -> tuple[Floats, Floats]:
    """[W]: cost that one simulation leaves of an explanation along another form of the data, if its
    unknowns and starts are corrected linearly; [P]: the step of the unknowns.

    Args:
      start: [W, 2 nv] where to start. own: its unknowns, and what they change. hints: what starts
        change, and how windows count. robust: as of `gauss_newton`.
      step: of the unknowns, where other windows have said; what these say if None.
    """
    problem = Problem(shooter, lambda _: variant, own.unknowns, hints, robust)
    here = problem.trial(own.values, start)
    free, problem.scale = hints.free, problem.half(here.cost)
    assert free is not None
    if step is None:
        left, weighted = problem.shares(here, own.slopes, free)
        step = problem.parameter_step(own.values, left, weighted, _DAMPING)
        step = np.clip(step, problem.low - own.values, problem.high - own.values)
    wanted = here.residual - own.slopes @ step
    moves = least_squares(free, wanted, np.zeros(len(wanted)))
    return problem.window_costs(wanted - np.einsum("wdf,wf->wd", free, moves)), step


def _corrected(
    problem: Problem, values: Floats, residual: Floats, slopes: Floats, free: Floats
) -> tuple[Floats, Floats]:
    """[W]: cost after a linear correction of unknowns and starts; [P]: that of the unknowns.
    Large residuals, which say how far from linear a window is, count less and less (reweighted
    least squares)."""
    now, none, step = residual, np.zeros(len(residual)), np.zeros(len(values))
    for _ in range(1 if problem.robust is None else _REWEIGHTED):
        left, weighted = problem.projected(residual, slopes, free, now)
        step = _bounded_step(problem, values, left, weighted)
        wanted, root = residual - slopes @ step, np.sqrt(problem.weights(now))
        moves = least_squares(free * root[..., None], wanted * root, none)
        now = wanted - np.einsum("wdf,wf->wd", free, moves)
    return problem.window_costs(now), step


def _bounded_step(problem: Problem, values: Floats, left: Floats, weighted: Floats) -> Floats:
    """[P]: a step of which nothing leaves the bounds; if the last unknown would, it stops there
    and the others make up for it."""
    step = problem.parameter_step(values, left, weighted, _DAMPING)
    if not len(step):
        return step
    room = problem.low - values, problem.high - values
    last = float(np.clip(step[-1], room[0][-1], room[1][-1]))
    if last != step[-1]:
        held = left - weighted[..., -1] * last
        few = Problem(
            problem.shooter, problem.build, problem.unknowns[:-1], problem.hints, problem.robust
        )
        step = np.append(few.parameter_step(values[:-1], held, weighted[..., :-1], _DAMPING), last)
    return np.clip(step, *room)


_SIZE = Unknown("size", 1.0, 0.2, 3.0, 1e-4, 1.0, 1.0)
"""Of the difference that an effect makes; a wide prior keeps it where nothing says otherwise."""
_DAMPING = 1e-4
"""As of the first step of a fit."""
_REWEIGHTED = 5
"""Rounds of reweighted least squares."""
