"""Numbers of which the data determine a combination and not the numbers themselves.

As the base parameters of a robot (Gautier, J. Robotic Systems 8, 1991; Khalil and Dombre, Modeling,
Identification and Control of Robots, 2002): where a column of the Jacobian is a linear combination
of others, sum_i b_i (column i), all that is determined is each x_i + b_i x. Here columns are
measured in usual sizes of their numbers and standard deviations of the data, so that "is a linear
combination" has a scale: beside the others, the data leave a number less sure than its usual size.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from orbisim.shooting.fits import Fit

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Tie:
    """A combination that is determined: a number plus multiples of others.

    Attributes:
      first: the number whose coefficient is 1. others: coefficients of the others.
    """

    first: int
    others: Mapping[int, float]


Possible = Callable[[Floats], bool]
"""Whether fitted numbers [own] can be other ones by so much."""


def ties(
    gram: Floats,
    size: Floats,
    own: int,
    beside: Mapping[int, Sequence[int]] = MappingProxyType({}),
    possible: Possible = lambda _: True,
) -> list[Tie]:
    """What is determined of numbers that are not.

    Of fitted numbers the one that is least sure beside the others is taken out, as long as that is
    less sure than its size. Of what may be there in their place, that is tied to them which the
    data leave less sure than its size, or whose column differs from a combination of theirs by less
    than `ALIKE`. Numbers that change the data by less than one standard deviation when they change
    by their size are tied to nothing: they are not felt. What may be there in the place of others
    changes the data no more than these do.

    Args:
      gram: [N, N] information: inner products of the columns, in standard deviations of the data,
        and precisions of priors on numbers without a size.
      size: [N] usual size of each number, with its sign; 0 for those that only say where or how
        something is.
      own: how many of them are fitted, the first ones. The others may be there in their place.
      beside: which numbers say where or how another is.
      possible: asked of what half the usual size of another would change of the fitted numbers.
    """
    change = np.sqrt([_left(gram, k, beside.get(k, ())) for k in range(len(gram))])
    most = float((change * np.abs(size))[:own].max(initial=0.0))
    unit = np.where(size == 0, 1 / change, np.sign(size) * np.minimum(np.abs(size), most / change))
    scaled, whole = gram * np.outer(unit, unit), change * np.abs(unit)
    felt, blur = (size != 0) & (whole >= 1), np.maximum(1.0, ALIKE * whole)
    base, share = [k for k in range(own) if felt[k] or not size[k]], dict[int, Floats]()
    while True:
        spread = np.sqrt(np.diag(inverse_of(scaled[np.ix_(base, base)])))
        doubt = np.where(felt[base], spread, 0.0)
        if not doubt.max(initial=0.0) > 1:
            break
        share[base.pop(int(np.argmax(doubt)))] = np.zeros(0)
    for k in [*share, *(np.flatnonzero(felt[own:]) + own)]:
        with_it = [*base, *beside.get(k, ())]
        across = scaled[with_it, k]
        explained = inverse_of(scaled[np.ix_(with_it, with_it)]) @ across
        share[k], moved = explained[: len(base)], np.zeros(own)
        moved[base] = -share[k] * unit[base] / 2
        least = max(blur[k], _ROUGH * np.sqrt(scaled[k, k]))
        told = scaled[k, k] - across @ explained >= least**2
        if k >= own and (told or not possible(moved)):
            del share[k]
    found = []
    for row, i in enumerate(base):
        others = {
            int(k): float(b[row] * unit[i] / unit[k])
            for k, b in share.items()
            if abs(b[row]) > spread[row] * blur[k]
        }
        if others and felt[i]:
            found.append(Tie(i, others))
    return found


def _left(gram: Floats, k: int, others: Sequence[int]) -> float:
    """Square of a column that others cannot make up for."""
    index = list(others)
    across = gram[index, k]
    explained = across @ inverse_of(gram[np.ix_(index, index)]) @ across if index else 0.0
    return max(float(gram[k, k] - explained), 1e-300)


ALIKE = 0.05
"""Share of a column by which models are wrong anyway: friction next to rest, locks that give."""


def inverse_of(gram: Floats) -> Floats:
    """Of information; what it is singular by to within rounding has a large variance."""
    unit = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(unit, unit))
    inverse = vectors / np.maximum(values, _ROUNDING * values.max(initial=1.0)) @ vectors.T
    return np.asarray(inverse / np.outer(unit, unit))


_ROUGH = 1e-3
"""Share of a column that is the error of its differences."""
_ROUNDING = 1e-11
"""Eigenvalue, over the largest, that is rounding."""


def tied(fit: Fit, found: Sequence[Tie], own: int) -> Fit:
    """A fit in terms of combinations: each in the place of its first number.

    Args:
      own: numbers from this one on were not fitted: there is nothing of them.
    """
    count = len(fit.values)
    to = np.eye(count)
    for one in found:
        for k, b in one.others.items():
            if k < own:
                to[one.first, k] = b
    back = 2 * np.eye(count) - to  # its inverse: no first number is another's
    return dataclasses.replace(
        fit,
        values=to @ fit.values,
        information=back.T @ fit.information @ back,
        prior=None if fit.prior is None else back.T @ fit.prior @ back,
        score=fit.score @ back,
        covariance=to @ fit.covariance @ to.T,
    )
