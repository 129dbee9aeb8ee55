"""Nonlinear least squares of many problems at once, with intervals.

Values are searched by their logarithm, by damped Gauss-Newton steps (Levenberg 1944, Marquardt
1963) on errors weighted down where they are large (Cauchy's weights, Holland and Welsch 1977), with
the derivatives that forward-mode differentiation of the residuals gives. A broad prior, a factor
of `PRIOR` either way at one standard deviation, keeps what no window shows where it was declared.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import torch
from scipy import stats
from torch import Tensor
from torch.autograd import forward_ad

from orbisim.host.progress import track

LARGE = 3.0
"""In units of the errors: where weights begin to fall."""
PRIOR = math.e**1.5
_DAMPING, _EASIER, _HARDER = 1e-2, 0.3, 8.0
_LONGEST = 0.7
"""Of a logarithm in one step: a factor of two."""
_AROUND = 1.0
"""Of a logarithm, either way: what is scanned, a factor of 2.7."""
_FEW = 3
"""Least degrees of freedom of an interval."""


@dataclasses.dataclass(frozen=True, eq=False)
class Estimate:
    """Values of G problems with P parameters.

    Attributes:
      values, low, high: [G, P], and 95 % intervals.
      cost: [G, steps + 1] mean weighted squared error before each step and at the end.
    """

    values: Tensor
    low: Tensor
    high: Tensor
    cost: Tensor


def estimate(
    residuals: Callable[[Tensor], Tensor],
    start: Tensor,
    bounds: tuple[Tensor, Tensor],
    group: Tensor,
    steps: int = 12,
    together: int = 1,
    scan: int = 0,
    spread: Tensor | None = None,
) -> Estimate:
    """Fits the parameters of each problem to its windows.

    Args:
      residuals: from values [K W, P] of each window, in K copies of all windows one after another,
        to their errors [K W, R], in units of typical ones, 0 where nothing was recorded.
      start: [G, P] values above 0; the middle of the prior, too.
      bounds: low and high, [P] or [G, P].
      group: [W] the problem that each window belongs to.
      steps: of the search.
      together: how many errors of a window count as one, since those of one coordinate at
        successive times depend on each other.
      scan: how many points around the start are tried first; the search begins from the best of
        them and the start. A loss that believes large errors little may have several minima.
      spread: [G, P], of the prior: standard deviations of the logarithms; `PRIOR`'s if None.
    """
    low, high = (bound.log() for bound in bounds)
    origin = start.log()
    known = torch.full_like(origin, math.log(PRIOR)) if spread is None else spread.to(origin)
    z, damping = origin.clamp(low, high), torch.full_like(start[:, :1], _DAMPING)
    z = _scanned(residuals, z, (low, high), (origin, known), group, together, scan)
    errors, slopes = _linear(residuals, z[group])
    cost = _costs(errors, z, (origin, known), group, together)
    history = [cost]
    for _ in track(range(steps), "identifying"):
        curvature, gradient, _ = _normal(errors, slopes, z, (origin, known), group, together)
        sizes = torch.diagonal(curvature, dim1=1, dim2=2)
        matrix = curvature + torch.diag_embed(damping * sizes)
        move = -torch.linalg.solve(matrix, gradient[..., None])[..., 0]
        trial = (z + move.clamp(-_LONGEST, _LONGEST)).clamp(low, high)
        tried = _linear(residuals, trial[group])
        after = _costs(tried[0], trial, (origin, known), group, together)
        better = after < cost
        z, cost = torch.where(better[:, None], trial, z), torch.where(better, after, cost)
        chosen = better[group]
        errors = torch.where(chosen[:, None], tried[0], errors)
        slopes = torch.where(chosen[:, None, None], tried[1], slopes)
        damping = torch.where(better[:, None], damping * _EASIER, damping * _HARDER)
        damping = damping.clamp(1e-6, 1e6)
        history.append(cost)
    width = widths(errors, slopes, z, group, together, known)
    below, above = ((z + sign * width).clamp(low, high).exp() for sign in (-1.0, 1.0))
    return Estimate(z.exp(), below, above, torch.stack(history, dim=1))


@torch.no_grad()  # type: ignore[untyped-decorator]
def _scanned(
    residuals: Callable[[Tensor], Tensor],
    z: Tensor,
    bounds: tuple[Tensor, Tensor],
    prior: tuple[Tensor, Tensor],
    group: Tensor,
    together: int,
    count: int,
) -> Tensor:
    """The best [G, P] of the start and of Sobol's first points around it (Sobol 1967)."""
    if not count:
        return z
    best, cost = z, _costs(residuals(z[group].exp()), z, prior, group, together)
    cost = cost.nan_to_num(torch.inf)
    points = torch.quasirandom.SobolEngine(z.shape[1]).draw(count + 1)[1:]  # the first is a corner
    for point in (2.0 * points.to(z) - 1.0) * _AROUND:
        trial = (prior[0] + point).clamp(*bounds)
        tried = _costs(residuals(trial[group].exp()), trial, prior, group, together)
        better = tried < cost  # not so where it is NaN
        best, cost = torch.where(better[:, None], trial, best), torch.where(better, tried, cost)
    return best


def _linear(residuals: Callable[[Tensor], Tensor], z: Tensor) -> tuple[Tensor, Tensor]:
    """Errors [W, R] and their derivatives [W, R, P] by the logarithms [W, P].

    All directions at once, each in a copy of the windows.
    """
    windows, size = z.shape
    tangent = torch.eye(size, dtype=z.dtype, device=z.device).repeat_interleave(windows, dim=0)
    with forward_ad.dual_level():
        dual = forward_ad.make_dual(z.detach().repeat(size, 1).requires_grad_(), tangent)
        found = forward_ad.unpack_dual(residuals(dual.exp()))
        slope = torch.zeros_like(found.primal) if found.tangent is None else found.tangent
        errors, slopes = found.primal[:windows].detach(), slope.detach()
    stacked = slopes.unflatten(0, (size, windows)).permute(1, 2, 0)
    return errors.nan_to_num(1e3, 1e3, -1e3), stacked.nan_to_num(0.0, 0.0, 0.0)


def _weights(errors: Tensor) -> Tensor:
    return 1.0 / (1.0 + (errors / LARGE).square())


def _costs(
    errors: Tensor, z: Tensor, prior: tuple[Tensor, Tensor], group: Tensor, together: int
) -> Tensor:
    """[G]: Cauchy's loss over all errors, and the prior's (mean and deviation, [G, P])."""
    each = 0.5 * LARGE**2 * torch.log1p((errors / LARGE).square())
    total = torch.zeros(len(z), dtype=z.dtype, device=z.device)
    total = total.index_add(0, group, each.sum(1).to(z.dtype) / together)
    return total + 0.5 * ((z - prior[0]) / prior[1]).square().sum(1)


def _normal(
    errors: Tensor,
    slopes: Tensor,
    z: Tensor,
    prior: tuple[Tensor, Tensor],
    group: Tensor,
    together: int,
) -> tuple[Tensor, Tensor, Tensor]:
    """Curvature [G, P, P] and gradient [G, P] of the cost, and its part [W, P] of each window."""
    weight = _weights(errors)
    pulled = slopes * weight[..., None] / together
    curvatures = pulled.transpose(1, 2) @ slopes  # [W, P, P]
    scores = (pulled * errors[..., None]).sum(1)  # [W, P]
    count, size = z.shape
    precision = prior[1].square().reciprocal()
    curvature = torch.zeros(count, size, size, dtype=z.dtype, device=z.device)
    curvature = curvature.index_add(0, group, curvatures.to(z.dtype))
    curvature = curvature + torch.diag_embed(precision)
    gradient = torch.zeros_like(z).index_add(0, group, scores.to(z.dtype))
    return curvature, gradient + precision * (z - prior[0]), scores.to(z.dtype)


def widths(
    errors: Tensor,
    slopes: Tensor,
    z: Tensor,
    group: Tensor,
    together: int,
    spread: Tensor | None = None,
) -> Tensor:
    """Half-widths [G, P] of 95 % intervals of the logarithms; `spread` as of `estimate`.

    The larger of two: from the curvature and the size of the errors that are left, and from how
    much windows disagree (the sandwich of Huber 1967). Each window counts once.
    """
    spread = torch.full_like(z, math.log(PRIOR)) if spread is None else spread
    curvature, _, scores = _normal(errors, slopes, z, (z, spread), group, together)
    inverse = torch.linalg.inv(curvature)
    count, size = z.shape
    windows = torch.zeros(count, dtype=z.dtype, device=z.device)
    windows = windows.index_add(0, group, torch.ones_like(group, dtype=z.dtype))
    left = torch.zeros_like(windows)
    left = left.index_add(0, group, (_weights(errors) * errors.square()).mean(1).to(z.dtype))
    spare = (windows - size).clamp(min=1.0)
    plain = torch.diagonal(inverse, dim1=1, dim2=2) * (left / spare).clamp(min=1e-6)[:, None]
    meat = torch.zeros_like(curvature)
    meat = meat.index_add(0, group, scores[:, :, None] * scores[:, None, :])
    sandwich = torch.diagonal(inverse @ meat @ inverse, dim1=1, dim2=2)
    sandwich = sandwich * (windows / spare)[:, None]
    # what no window shows is as uncertain as the prior has it
    known = spread.square()
    shown = torch.diagonal(inverse, dim1=1, dim2=2) / known
    variance = torch.maximum(plain, sandwich).minimum(known)
    variance = torch.maximum(variance, known * shown.square())
    quantile = stats.t.ppf(0.975, spare.clamp(min=_FEW).cpu().numpy())
    factor = torch.as_tensor(quantile, dtype=z.dtype, device=z.device)
    return factor[:, None] * variance.sqrt()
