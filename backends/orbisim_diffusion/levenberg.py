"""Levenberg-Marquardt on the difference of drawn and seen pixels, from several starts at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from orbisim_diffusion.synthesis import Eye

Floats = npt.NDArray[np.float64]
_HUBER = 0.1
"""Of a pixel's value (0 to 1): from here on an error counts in proportion, not squared."""
_WIDE, _NARROW, _SHRINK, _GAIN = 3.0, 0.5, 0.5, 0.1
"""Central differences are this wide to either side: so many pixels of the fastest motion at first
and at last, and the factor after a step that lowers the cost by a smaller share than the last. A
secant over pixels sees what a derivative cannot: edges between faces, outlines and shadows that are
not met yet."""
_FIRST, _DOWN, _UP, _MOST = 1e-2, 0.3, 5.0, 1e4
"""Damping at first, its factors after a step that helps and after one that does not, and where a
start is given up."""
SETTLED = 1e-3
"""A step that lowers the cost by a smaller share is the last; one that promises less is not tried.
"""


class Prior(NamedTuple):
    """What is known of each coordinate of a change [k] beside the image.

    Attributes:
      centre, std: [k]. tails: degrees of freedom of Student's distribution; a normal one if
        infinite.
    """

    centre: Floats
    std: Floats
    tails: float = np.inf

    def cost(self, x: Floats) -> Floats:
        """[S] of changes [S, k]: minus the logarithm of the density, 0 at the centre."""
        squares = ((x - self.centre) / self.std) ** 2
        if np.isinf(self.tails):
            found: Floats = 0.5 * squares.sum(-1)
        else:
            found = 0.5 * (self.tails + 1.0) * np.log1p(squares / self.tails).sum(-1)
        return found

    def weight(self, x: Floats) -> Floats:
        """[S, k]: of a square about the centre that has the same slope."""
        found: Floats = np.broadcast_to(self.std**-2.0, x.shape)
        if not np.isinf(self.tails):
            squares = ((x - self.centre) / self.std) ** 2
            found = found * (self.tails + 1.0) / (self.tails + squares)
        return found


class Fit(NamedTuple):
    """Where starts came to; S of them.

    Attributes:
      qpos: [S, nq]. cost: [S] Huber's loss of the pixels in units of the noise, and the prior.
      precision: [S, k, k] of the directions, by the curvature there; 1/m^2, 1/rad^2.
    """

    qpos: Floats
    cost: Floats
    precision: Floats

    @property
    def best(self) -> int:
        """Number of the start with the lowest cost."""
        return int(np.argmin(self.cost))


def fit(
    eye: Eye,
    image: torch.Tensor,
    pixels: torch.Tensor,
    starts: Floats,
    directions: Floats,
    *,
    noise: float,
    priors: Sequence[Prior] = (),
    geoms: torch.Tensor | None = None,
    steps: int = 12,
    settled: float = SETTLED,
    wide: bool = True,
    fine: int = 1,
) -> Fit:
    """The states near the starts whose image is most like one that was seen.

    Minimises sum(rho(drawn - seen)) / noise^2 and what priors add, of the change x along the
    directions since the start.

    Args:
      eye: draws. image: [H, W, 3], 0 to 1. pixels: [P] numbers of those that count.
      starts: [S, nq]. directions: [S, nv, k] of coordinates that may change.
      noise: standard deviation of a pixel's value. priors: what is known beside the image.
      geoms: that matter in these pixels; all if None.
      steps: at most. settled: see `SETTLED`. wide: whether starts may be pixels off. fine: see
        `Eye.draw`.
    """
    count, k = len(starts), directions.shape[-1]
    wanted = image.reshape(-1, 3)[pixels].double().numpy().reshape(-1)
    problem = _Problem(eye, wanted, pixels, geoms, noise, fine)
    at, x, damping = starts.copy(), np.zeros((count, k)), np.full(count, _FIRST)
    width = np.full(count, _WIDE if wide else _NARROW)
    cost, gradient, curvature = problem.linear(at, directions, width)
    cost = cost + sum(prior.cost(x) for prior in priors)
    active = np.ones(count, bool)
    for _ in range(steps):
        rows = np.flatnonzero(active)
        if not len(rows):
            break
        slope, matrix = gradient[rows], curvature[rows]
        for prior in priors:
            weight = prior.weight(x[rows])
            slope = slope + weight * (x[rows] - prior.centre)
            matrix = matrix + weight[:, :, None] * np.eye(k)
        diagonal = np.einsum("sii->si", matrix)
        scale = damping[rows, None] * np.maximum(diagonal, 1e-9 * diagonal.max(1, keepdims=True))
        damped = matrix + np.einsum("si,ij->sij", scale + 1e-9, np.eye(k))
        move = -np.linalg.solve(damped, slope[..., None])[..., 0]
        promised = -np.einsum("sk,sk->s", slope, move)
        promised -= 0.5 * np.einsum("sk,skl,sl->s", move, matrix, move)
        there = (width[rows] <= _NARROW) & (promised < settled * cost[rows])
        active[rows[there]] = False
        rows, move = rows[~there], move[~there]
        if not len(rows):
            continue
        trial = eye.moved(at[rows], np.einsum("svk,sk->sv", directions[rows], move))
        new = problem.cost(trial) + sum(prior.cost(x[rows] + move) for prior in priors)
        better, gain = new < cost[rows], 1.0 - new / cost[rows]
        narrowest = width[rows] <= _NARROW
        narrower = np.maximum(_NARROW, _SHRINK * width[rows])
        width[rows] = np.where(gain > _GAIN, width[rows], narrower)
        taken = rows[better]
        at[taken], x[taken], cost[taken] = trial[better], (x[rows] + move)[better], new[better]
        renewed = rows[better | ~narrowest]  # others would come out as they are
        if len(renewed):
            _, gradient[renewed], curvature[renewed] = problem.linear(
                at[renewed], directions[renewed], width[renewed]
            )
        damping[rows] *= np.where(better, _DOWN, _UP)
        active[rows[better & narrowest & (gain < settled)]] = False
        active &= damping < _MOST
    known = sum((prior.weight(x) for prior in priors), np.zeros((count, k)))
    return Fit(at, cost, curvature + known[:, :, None] * np.eye(k))


def cost(
    eye: Eye,
    image: torch.Tensor,
    pixels: torch.Tensor,
    state: Floats,
    *,
    noise: float,
    priors: Sequence[Prior],
    geoms: torch.Tensor | None = None,
) -> float:
    """What `fit` minimises, where it begins: at a state [nq]; see there."""
    wanted = image.reshape(-1, 3)[pixels].double().numpy().reshape(-1)
    problem = _Problem(eye, wanted, pixels, geoms, noise, 1)
    known = sum(float(prior.cost(np.zeros((1, len(prior.centre))))[0]) for prior in priors)
    return float(problem.cost(state[None])[0]) + known


class _Problem:
    """Costs of states, and their first two derivatives along directions."""

    def __init__(
        self,
        eye: Eye,
        wanted: Floats,
        pixels: torch.Tensor,
        geoms: torch.Tensor | None,
        noise: float,
        fine: int,
    ) -> None:
        self.eye, self.wanted, self.pixels, self.geoms = eye, wanted, pixels, geoms
        self.noise, self.fine = noise, fine

    def cost(self, at: Floats) -> Floats:
        """[S] of states [S, nq]."""
        drawn = self.eye.draw(at, self.pixels, self.geoms, self.fine)
        error = drawn.pixels.double().numpy().reshape(len(at), -1) - self.wanted
        found: Floats = losses(error).sum(-1) / self.noise**2
        return found

    def linear(
        self, at: Floats, directions: Floats, width: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Cost [S], gradient [S, k], curvature [S, k, k] (Gauss and Newton's) at states [S, nq]."""
        count, k = len(at), directions.shape[-1]
        width_of = width[:, None] / self.eye.speeds(at, directions)  # [S, k]
        aside = (directions * width_of[:, None]).transpose(0, 2, 1)
        change = np.concatenate([np.zeros((count, 1, aside.shape[-1])), aside, -aside], axis=1)
        states = self.eye.moved(at[:, None].repeat(2 * k + 1, 1), change)
        drawn = self.eye.draw(
            states.reshape(count * (2 * k + 1), -1), self.pixels, self.geoms, self.fine
        )
        values = drawn.pixels.double().numpy().reshape(count, 2 * k + 1, -1)
        error = values[:, 0] - self.wanted
        slope = (values[:, 1 : k + 1] - values[:, k + 1 :]) / (2 * width_of[..., None])
        weight = weights(error) / self.noise**2
        gradient = np.einsum("skp,sp->sk", slope, weight * error)
        curvature = np.einsum("skp,slp->skl", slope * weight[:, None], slope)
        return losses(error).sum(-1) / self.noise**2, gradient, curvature


def losses(error: Floats) -> Floats:
    """Huber's loss of errors of pixels."""
    size = np.abs(error)
    found: Floats = np.where(size < _HUBER, 0.5 * error**2, _HUBER * (size - 0.5 * _HUBER))
    return found


def weights(error: Floats) -> Floats:
    """Weights of squares that have the same gradient as `losses`."""
    found: Floats = np.minimum(1.0, _HUBER / np.maximum(np.abs(error), 1e-12))
    return found
