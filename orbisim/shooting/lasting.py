"""Noise that lasts for some samples, where bodies touch.

Filters, cameras and mounts have noise that is alike from sample to sample. White noise of the same
size would leave more of a stiff motion than such noise does, so that an estimate that takes it for
white comes out too low, and what is then left of free runs is named. Elsewhere the likelihood along
whole stretches tells (`orbisim.shooting.disturbances`); where bodies touch, stretches between
impacts are short: in them a start and a force with one slope are all that is unknown, and the
restricted likelihood of what these leave (Patterson and Thompson, Biometrika 58, 1971) tells how
long noise lasts. A force that a scene lacks hardly bends within them. What a timestep that is too
long does would look like noise that lasts, so that the motion may be that of ever shorter ones.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import scipy.linalg

from orbisim.evidence import SURE
from orbisim.motion.linear import Intervals
from orbisim.motion.samples import Samples
from orbisim.shooting.noise import Stretches, noise_left, stretches_of
from orbisim.shooting.windows import Windows

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

LASTING = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0)
"""Samples over which noise is lost (to 1/e), as far as stretches of sixteen tell."""


def lasting_noise(
    samples: Sequence[Samples],
    forms: Sequence[Intervals],
    windows: Windows,
    known: Sequence[Floats] | None = None,
) -> Floats:
    """[nv]: standard deviations of the noise of positions where it surely lasts; NaN where it is
    white, or not measured. Velocities are left out: a force that is missing bends them at once.

    Args:
      forms: the intervals in the scene's steps, and in others (`linear.extrapolated`): those count
        in which all stretches together are the likeliest.
      windows: stretches between impacts (`orbisim.shooting.noise.between_impacts`).
      known: for each recording what measurement effects add to it, [T, 2 nv].
    """
    nv = forms[0].B.shape[2]
    found = np.full(nv, np.nan)
    every = [stretches_of(samples, one, windows, known, stiff=True) for one in forms]
    some = [one for one in every if one is not None]
    positions = np.flatnonzero(some[0].measured < nv) if some else np.zeros(0, np.int64)
    if not len(positions):
        return found
    fitted = [[_fitted(one, positions, lost) for lost in (0.0, *LASTING)] for one in some]
    white, *longer = max(fitted, key=lambda fits: max(one.likelihood.sum() for one in fits))
    best = white
    for one in longer:  # of two that are as likely, the shorter leaves the lower noise
        if _surely(one.likelihood - best.likelihood):
            best = one
    if best is not white:
        found[some[0].measured[positions]] = best.sigma[positions]
    return found


def _surely(gains: Floats) -> bool:
    """Whether stretches typically gain: noise is the same in all of them, an impact that nobody saw
    is in few. The standard error of a median is 1.25 times that of a mean, and the deviation of
    normal numbers 1.48 times their median distance from it."""
    middle = float(np.median(gains))
    spread = 1.48 * float(np.median(np.abs(gains - middle)))
    return middle > SURE * 1.25 * spread / np.sqrt(len(gains))


@dataclasses.dataclass(frozen=True, eq=False)
class _Fit:
    """Noise of positions that is lost over some number of samples.

    Attributes:
      sigma: [measured] standard deviations. likelihood: [W] logarithms.
    """

    sigma: Floats
    likelihood: Floats


def _fitted(stretches: Stretches, positions: Ints, lost: float) -> _Fit:
    """Sizes of noise that is lost over so many samples, and how likely each stretch is with them;
    each has a scale of its own, as some have an impact that nobody saw."""
    white, decrease = _whitened(stretches, positions, lost)
    sigma, left = noise_left(white)
    spread = (white.seen.sum(axis=1) * np.log(sigma)).sum(axis=1)
    free, square = np.maximum(left.freedom, 1.0), np.maximum(left.square, 1e-300)
    likelihood = -spread - decrease - left.inner / 2 - free / 2 * np.log(square / free)
    return _Fit(sigma, likelihood)


def _whitened(stretches: Stretches, positions: Ints, lost: float) -> tuple[Stretches, Floats]:
    """Stretches whose noise would be white if that of positions is lost over so many samples; [W]
    by how much less a logarithm of a density is for that."""
    design, target = stretches.design.copy(), stretches.target.copy()
    decrease, count = np.zeros(len(design)), design.shape[1]
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    known: dict[bytes, Floats] = {}
    for w in range(len(design)) if lost else ():
        for s in positions:
            seen = stretches.seen[w, :, s]
            if seen.tobytes() not in known:
                alike = np.exp(-apart[np.ix_(seen, seen)] / lost)
                known[seen.tobytes()] = scipy.linalg.cholesky(alike, lower=True)
            lower = known[seen.tobytes()]
            both = np.column_stack([design[w, seen, s], target[w, seen, s]])
            both = scipy.linalg.solve_triangular(lower, both, lower=True)
            design[w, seen, s], target[w, seen, s] = both[:, :-1], both[:, -1]
            decrease[w] += np.log(np.diag(lower)).sum()
    return dataclasses.replace(stretches, design=design, target=target), decrease
