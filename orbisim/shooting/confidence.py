"""How sure fitted parameters are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy import stats

from orbisim.shooting.fits import Fit


def confidence(
    fit: Fit, names: Sequence[str], seed: int = 0, independent: float = np.inf
) -> dict[str, tuple[float, float]]:
    """95 % intervals of fitted parameters: the widest of three.

    These are the Jacobian's with as many data as count as independent, a block bootstrap's, and
    what whole recordings say.

    What a model lacks is much the same in all windows of a recording, so that these are not
    independent: recordings are, and their shares in the score have the cluster-robust covariance
    A^-1 (sum_g s_g s_g^T) A^-1 G / (G - 1), with the quantile of Student's t with G - 1 degrees of
    freedom (Liang and Zeger 1986; Cameron and Miller 2015). Two recordings are too few for that.

    The bootstrap resamples windows and takes one Gauss-Newton step from the fit. Where few windows
    feel a parameter, resamples that hardly contain any of them say nothing and are left out. Priors
    (of declared parameters that are retuned) say in each resample what they say in the fit.

    Args:
      independent: how many of the data count as independent.
    """
    count = len(fit.values)
    if not count:
        return {}
    rng = np.random.default_rng(seed)
    windows = len(fit.information)
    draws, felt = np.empty((_DRAWS, count)), np.zeros(_DRAWS, bool)
    told = fit.information.sum(axis=0) + (0.0 if fit.prior is None else fit.prior)
    scale = np.sqrt(np.maximum(np.diag(told), 1e-300))
    prior = _prior(fit, scale)
    # where a fit has ended, priors pull as much as the data do
    pull = np.where(np.diag(prior) > 0, -fit.score.sum(axis=0), 0.0)
    for d in range(_DRAWS):
        chosen = rng.integers(0, windows, windows)
        gram = fit.information[chosen].sum(axis=0) / np.outer(scale, scale) + prior
        felt[d] = np.diag(gram).min() >= _FELT
        moment = (fit.score[chosen].sum(axis=0) + pull) / scale
        draws[d] = fit.values + np.linalg.lstsq(gram, moment, rcond=1e-10)[0] / scale
    draws = draws[felt] if felt.any() else np.array([fit.values])
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    width = 1.96 * np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    width *= np.sqrt(max(fit.count / independent, 1.0))
    width = np.maximum(width, _by_recordings(fit, scale))
    low, high = np.minimum(low, fit.values - width), np.maximum(high, fit.values + width)
    return {n: (float(low[i]), float(high[i])) for i, n in enumerate(names)}


def told(
    fit: Fit, own: Sequence[int], neutral: Sequence[float], intervals: Sequence[tuple[float, float]]
) -> bool:
    """Whether numbers can be told from those at which nothing changes (Wald's test), as sure as
    their intervals are on the side where that is: resamples may lie further to one.

    Args:
      own: which of the fitted numbers. neutral: where nothing changes. intervals: of each.
    """
    index = list(own)
    nothing = np.array(neutral)
    low, high = np.array(intervals).reshape(-1, 2).T
    values = fit.values[index]
    half = np.where(values > nothing, values - low, high - values)
    deviation = np.sqrt(np.maximum(np.diag(fit.covariance)[index], 1e-300))
    # an interval may be as wide as numbers go: of a number that the data hardly feel
    width = np.maximum(np.where(np.isnan(half), np.inf, half / 1.96), deviation)
    correlation = fit.covariance[np.ix_(index, index)] / np.outer(deviation, deviation)
    away = (values - nothing) / width
    inverse = np.linalg.pinv(np.nan_to_num(correlation), rcond=1e-12, hermitian=True)
    return bool(away @ inverse @ away >= TOLD**2 * len(index))


TOLD = 2.0
"""Standard deviations by which an effect's numbers must differ from nothing."""


def _prior(fit: Fit, scale: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """[P, P]: what priors say, of scaled parameters."""
    known = np.zeros((len(scale), len(scale))) if fit.prior is None else fit.prior
    return np.asarray(known / np.outer(scale, scale))


def _by_recordings(fit: Fit, scale: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """[P]: half-widths by the shares of whole recordings; zero if these are not known, or few."""
    none = np.zeros(len(fit.values))
    if fit.recording is None:
        return none
    names, group = np.unique(fit.recording, return_inverse=True)
    count = len(names)
    if count < _FEWEST:
        return none
    shares = np.zeros((count, len(none)))
    np.add.at(shares, group, fit.score / scale)
    shares -= shares.mean(axis=0)  # a prior's pull is no recording's
    gram = fit.information.sum(axis=0) / np.outer(scale, scale) + _prior(fit, scale)
    moved = shares @ np.linalg.pinv(gram, rcond=1e-10, hermitian=True)
    spread = np.sqrt(count / (count - 1) * (moved**2).sum(axis=0)) / scale
    return np.asarray(stats.t.ppf(0.975, count - 1) * spread)


_FEWEST = 3
"""Recordings: with two, Student's quantile is 12.7 and says that nothing is known."""
_DRAWS = 200
"""Resamples: five of them lie beyond either end of an interval."""
_FELT = 1e-4
"""Share of what all windows say about a parameter that a resample must say."""
